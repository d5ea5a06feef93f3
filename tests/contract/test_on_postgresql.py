"""What PostgreSQL takes otherwise than SQLite does, over real HTTP."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.postgres import postgres_database
from tests.service import LiveApi, live_api, settings_for


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    folder = tmp_path_factory.mktemp("service")
    with postgres_database() as url, live_api(settings_for(folder, database_url=url)) as running:
        yield running


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/v1/webhooks", {"url": "https://example.org", "site_id": "site\0"}),
        ("/v1/webhooks", {"url": "https://example.org", "job_id": "job\0"}),
        ("/v1/webhooks", {"url": "https://example.org", "site_id": ""}),
        ("/v1/models", {"job_id": "job\0"}),
        ("/v1/models", {"site_id": "site\0", "file_id": "file\0"}),
    ],
)
def test_an_id_that_none_can_be_is_refused_by_name(api: LiveApi, path: str, body: dict[str, Any]) -> None:
    answer = api.http.post(path, json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), answer.text
    assert "_id: " in answer.json()["detail"]


@pytest.mark.parametrize(
    ("path", "key"),
    [
        ("/v1/audit", [2**31]),  # no column of numbers is wider
        ("/v1/jobs", [1.0, "\0"]),
        ("/v1/jobs", [1.0, "\ud800"]),
        ("/v1/jobs", [10**400, "x"]),
    ],
)
def test_what_no_column_can_hold_is_a_fault_of_who_asks(api: LiveApi, path: str, key: list[Any]) -> None:
    cursor = base64.urlsafe_b64encode(json.dumps(key).encode()).decode()
    answer = api.http.get(path, params={"cursor": cursor})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_input"), answer.text
