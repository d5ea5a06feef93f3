"""What the API says of itself: every operation described, and nothing loaded from elsewhere."""

from __future__ import annotations

import json
import re
from typing import Any

import httpx
import pytest

from tests.service import LiveApi


class TestOpenApi:
    @pytest.fixture
    def document(self, api: LiveApi) -> dict[str, Any]:
        found: dict[str, Any] = httpx.get(f"{api.url}/openapi.json", timeout=300).json()
        return found

    def operations(self, document: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
        return [(path, method, op) for path, ops in document["paths"].items() for method, op in ops.items()]

    def test_every_operation_is_summarised_and_tagged(self, document: dict[str, Any]) -> None:
        for path, method, operation in self.operations(document):
            assert operation["summary"], f"{method} {path}"
            assert operation["tags"], f"{method} {path}"

    def test_everything_under_v1_and_the_figures_say_that_they_need_the_token(self, document: dict[str, Any]) -> None:
        for path, method, operation in self.operations(document):
            needs_it = (path.startswith("/v1/") or path == "/metrics") and method != "options"
            assert ("security" in operation) == needs_it, f"{method} {path}"

    def test_every_error_is_a_problem(self, document: dict[str, Any]) -> None:
        for path, method, operation in self.operations(document):
            for status, response in operation["responses"].items():
                if status[0] in "45":
                    if "$ref" in response:
                        response = document["components"]["responses"][response["$ref"].rpartition("/")[2]]
                    assert list(response["content"]) == ["application/problem+json"], f"{method} {path} {status}"

    def test_every_reference_leads_somewhere(self, document: dict[str, Any]) -> None:
        text = json.dumps(document)
        for name in set(re.findall(r"#/components/schemas/([^\"]+)", text)):
            assert name in document["components"]["schemas"], name

    def test_the_page_loads_nothing_from_elsewhere(self, api: LiveApi) -> None:
        page = httpx.get(f"{api.url}/docs", timeout=300).text
        assert "http://" not in page
        assert "https://" not in page
