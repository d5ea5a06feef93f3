"""Keys with scopes, what each opens, and who changed what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import httpx
import pytest
import sqlalchemy

from api.access import needed_scope
from tests.builders import corner_rig, site_of
from tests.service import TOKEN, LiveApi
from wibam_core.adapters.key_store import KeyStore
from wibam_core.adapters.models import ApiKeyRow
from wibam_core.jobs.access import Scope


def key(api: LiveApi, *scopes: str, **more: Any) -> dict[str, Any]:
    answer = api.http.post("/v1/keys", json={"name": "test", "scopes": list(scopes), **more})
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    return found


def ask(api: LiveApi, secret: str, method: str, path: str, **values: Any) -> httpx.Response:
    return httpx.request(method, api.url + path, headers={"Authorization": f"Bearer {secret}"}, timeout=300, **values)


class TestScopes:
    @pytest.fixture
    def requests(self, api: LiveApi) -> Sequence[tuple[str, str, str, dict[str, Any]]]:
        site = api.site()
        return [
            ("read", "GET", "/v1/sites", {}),
            ("read", "GET", f"/v1/sites/{site}", {}),
            ("read", "POST", f"/v1/sites/{site}/plan", {"json": {}}),
            ("upload", "POST", "/v1/sites", {"json": site_of(corner_rig(1)).model_dump(mode="json")}),
            ("upload", "POST", "/v1/uploads", {}),
            ("upload", "HEAD", "/v1/uploads/file_0123456789abcdef", {}),
            ("run", "POST", f"/v1/sites/{site}/jobs", {"json": {}}),
            ("run", "DELETE", "/v1/jobs/job_0123456789abcdef", {}),
            ("admin", "GET", "/v1/keys", {}),
            ("admin", "POST", "/v1/keys", {"json": {"name": "x", "scopes": ["admin"]}}),
            ("admin", "GET", "/v1/audit", {}),
        ]

    @pytest.mark.parametrize("scope", ["read", "upload", "run", "admin"])
    def test_a_key_opens_what_its_scope_says_and_nothing_else(
        self, api: LiveApi, requests: Sequence[tuple[str, str, str, dict[str, Any]]], scope: str
    ) -> None:
        secret = key(api, scope)["secret"]
        for needed, method, path, values in requests:
            status = ask(api, secret, method, path, **values).status_code
            assert (status == 403) == (scope not in (needed, "admin")), (method, path, status)

    def test_a_refusal_names_the_scope(self, api: LiveApi) -> None:
        body = ask(api, key(api, "read")["secret"], "POST", "/v1/sites", json={}).json()
        assert (body["code"], body["details"]) == ("forbidden", {"scope": "upload"})
        assert "upload" in body["hint"]

    def test_what_no_rule_knows_is_for_administrators(self) -> None:
        assert needed_scope("POST", "/v1/unheard/of") is Scope.ADMIN
        assert needed_scope("BREW", "/v1/sites") is Scope.ADMIN

    def test_every_operation_says_its_scope(self, api: LiveApi) -> None:
        paths = httpx.get(f"{api.url}/openapi.json", timeout=300).json()["paths"]
        scopes = {
            (method, path): operation["security"][0]["token"]
            for path, operations in paths.items()
            for method, operation in operations.items()
            if "security" in operation
        }
        for_administrators = {path for (_, path), needed in scopes.items() if needed == ["admin"]}
        assert all(path.startswith(("/v1/keys", "/v1/audit")) for path in for_administrators)
        assert scopes["post", "/v1/sites/{site_id}/jobs"] == ["run"]


class TestKeys:
    def test_a_revoked_and_an_expired_one_open_nothing(self, api: LiveApi) -> None:
        made = key(api, "read")
        assert ask(api, made["secret"], "GET", "/v1/sites").status_code == 200
        assert api.http.delete(f"/v1/keys/{made['id']}").json()["works"] is False
        assert ask(api, made["secret"], "GET", "/v1/sites").status_code == 401
        late = KeyStore(api.services.database, now=lambda: 1000.0).create("old", [Scope.READ], lifetime_s=60.0)[1]
        assert ask(api, late, "GET", "/v1/sites").status_code == 401
        assert api.http.delete("/v1/keys/key_0").status_code == 404

    def test_the_secret_is_told_once_and_kept_nowhere(self, api: LiveApi) -> None:
        made = key(api, "read", lifetime_days=1)
        assert made["secret"].startswith("wibam_")
        assert made["secret"] not in api.http.get("/v1/keys").text
        with api.services.database.reading() as session:
            rows = session.execute(sqlalchemy.select(ApiKeyRow.__table__)).all()
        assert made["secret"] not in str(rows)

    def test_use_is_noted(self, api: LiveApi) -> None:
        made = key(api, "read")
        assert made["last_used_at"] is None
        ask(api, made["secret"], "GET", "/v1/sites")
        [listed] = [one for one in api.http.get("/v1/keys").json() if one["id"] == made["id"]]
        assert listed["last_used_at"] is not None

    @pytest.mark.parametrize(
        "body", [{"name": "x", "scopes": []}, {"name": "", "scopes": ["read"]}, {"name": "x", "scopes": ["root"]}]
    )
    def test_what_makes_no_sense_is_refused(self, api: LiveApi, body: dict[str, Any]) -> None:
        assert api.http.post("/v1/keys", json=body).status_code == 422


class TestAudit:
    def test_every_change_has_a_line_with_who_what_and_request(self, api: LiveApi) -> None:
        made = key(api, "upload")
        answer = ask(api, made["secret"], "POST", "/v1/sites", json=site_of(corner_rig(1)).model_dump(mode="json"))
        [line] = api.http.get("/v1/audit", params={"who": made["id"]}).json()
        assert (line["what"], line["status"]) == ("POST /v1/sites", 201)
        assert line["request_id"] == answer.headers["X-Request-ID"]
        assert line["address"] == "127.0.0.1"

    def test_what_was_refused_is_told_too_and_what_changes_nothing_is_not(self, api: LiveApi) -> None:
        made = key(api, "read", "admin")
        ask(api, made["secret"], "POST", "/v1/sites", json={})
        ask(api, made["secret"], "GET", "/v1/sites")
        ask(api, made["secret"], "POST", f"/v1/sites/{api.site()}/plan", json={})
        lines = api.http.get("/v1/audit", params={"who": made["id"]}).json()
        assert [(line["what"], line["status"]) for line in lines] == [("POST /v1/sites", 422)]

    def test_pages_follow_each_other(self, api: LiveApi) -> None:
        for _ in range(3):
            key(api, "read")
        answer = api.http.get("/v1/audit", params={"limit": 2})
        first = answer.json()
        second = api.http.get(answer.links["next"]["url"]).json()
        ids = [line["id"] for line in first + second]
        assert ids == sorted(ids, reverse=True)
        assert len(set(ids)) == 4

    def test_what_a_key_is_refused_has_a_line_too(self, api: LiveApi) -> None:
        made = key(api, "read")
        assert ask(api, made["secret"], "DELETE", "/v1/jobs/job_0").status_code == 403
        [line] = api.http.get("/v1/audit", params={"who": made["id"]}).json()
        assert (line["what"], line["status"]) == ("DELETE /v1/jobs/job_0", 403)


class TestRequestIds:
    def test_what_fails_unforeseen_has_one(self, api: LiveApi, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(api.services.keys, "keys", lambda *limit, **filters: 1 / 0)
        answer = api.http.get("/v1/keys")
        assert answer.status_code == 500
        assert answer.headers["X-Request-ID"] == answer.json()["request_id"] != ""

    def test_a_key_and_no_database_is_no_fault_of_ours(self, api: LiveApi, monkeypatch: pytest.MonkeyPatch) -> None:
        def gone(secret: str) -> None:
            raise sqlalchemy.exc.OperationalError("SELECT", {}, OSError("gone"))

        monkeypatch.setattr(api.services.keys, "find", gone)
        answer = ask(api, "wibam_anything", "GET", "/v1/sites")
        assert (answer.status_code, answer.json()["code"]) == (503, "service_unavailable")

    def test_a_plain_one_is_kept_and_another_replaced(self, api: LiveApi) -> None:
        headers = {"X-Request-ID": "mine-1"}
        answer = api.http.get("/v1/jobs/job_0", headers=headers)
        assert answer.headers["X-Request-ID"] == answer.json()["request_id"] == "mine-1"
        other = api.http.get("/v1/sites", headers={"X-Request-ID": "a b\tc"})
        assert other.headers["X-Request-ID"] not in ("", "a b\tc")

    def test_who_comes_without_a_token_learns_it_too(self, api: LiveApi) -> None:
        answer = httpx.get(f"{api.url}/v1/sites", timeout=300)
        assert answer.status_code == 401
        assert answer.headers["X-Request-ID"] == answer.json()["request_id"]


def test_links_are_not_signed_by_what_a_settings_file_shows(api: LiveApi) -> None:
    secret = api.services.folder.secret()
    assert (api.services.folder.root / "secret").stat().st_mode & 0o777 == 0o600
    assert secret not in (TOKEN, api.services.settings.token_sha256)
