"""What the schema shows: every JSON response has fields, and documents say their units and meanings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from api.main import create_app
from tests.service import settings_for


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder: Path = tmp_path_factory.mktemp("data")
    return create_app(settings_for(folder)).openapi()


def test_no_json_response_is_untyped(document: dict[str, Any]) -> None:
    untyped = [
        f"{method} {path} {status}"
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
        for status, response in operation["responses"].items()
        for media_type, content in response.get("content", {}).items()
        if "json" in media_type and not content.get("schema")
    ]
    assert untyped == []


@pytest.mark.parametrize(
    ("path", "model"),
    [
        ("/v1/jobs/{job_id}/metrics", "Metrics"),
        ("/v1/jobs/{job_id}/conflicts", "Conflicts"),
        ("/v1/jobs/{job_id}/tracks", "TrackPage"),
    ],
)
def test_results_are_the_documents(document: dict[str, Any], path: str, model: str) -> None:
    schema = document["paths"][path]["get"]["responses"]["200"]["content"]["application/json"]["schema"]
    assert schema == {"$ref": f"#/components/schemas/{model}"}


def test_fields_say_what_they_mean(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    assert "Reference clock" in schemas["TrackState"]["properties"]["time_ns"]["description"]
    assert "time to collision" in schemas["ConflictRow"]["properties"]["ttc_s"]["description"].lower()
    assert "ground rectangles" in schemas["DetectorFigures"]["properties"]["bev_iou"]["description"]
    assert schemas["TrackState"]["properties"]["class"]["type"] == "string"
