"""Webhooks over real HTTP: made, tried, sent by the running service, checked as docs/service.md says."""

from __future__ import annotations

import ipaddress
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner

from tests.conftest import ROOT
from tests.finished import finished_job
from tests.receiver import Receiver, receiver
from tests.service import TOKEN, LiveApi, live_api, settings_for, wait_until
from wibam_core.cli.webhooks import app


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    folder = tmp_path_factory.mktemp("service")
    with live_api(settings_for(folder, webhook_networks=(ipaddress.ip_network("127.0.0.0/8"),))) as running:
        yield running


@pytest.fixture
def told() -> Iterator[Receiver]:
    with receiver() as running:
        yield running


def the_check() -> Any:
    """`check` of docs/service.md."""
    [snippet] = re.findall(r"```python\n(.*?def check.*?)```", (ROOT / "docs" / "service.md").read_text(), re.DOTALL)
    names: dict[str, Any] = {}
    exec(snippet, names)
    return names["check"]


def test_a_job_that_ends_is_told_and_the_documented_check_takes_it_and_nothing_else(
    api: LiveApi, told: Receiver
) -> None:
    made = api.http.post("/v1/webhooks", json={"url": told.url}).json()
    job = finished_job(api)
    wait_until(lambda: bool(told.got))
    [received] = told.got
    check = the_check()
    assert check(made["secret"], received.headers, received.body) == json.loads(received.body)
    assert json.loads(received.body)["data"]["job_id"] == job
    old = {**received.headers, "webhook-timestamp": "1600000000"}
    for headers, body in ((received.headers, received.body + b" "), (old, received.body)):
        with pytest.raises(ValueError, match="webhook"):
            check(made["secret"], headers, body)
    with pytest.raises(ValueError, match="webhook"):
        check(api.http.post("/v1/webhooks", json={"url": told.url}).json()["secret"], received.headers, received.body)
    path = f"/v1/webhooks/{made['id']}"
    wait_until(lambda: api.http.get(f"{path}/deliveries").json()[0]["state"] == "delivered")
    [delivery] = api.http.get(f"{path}/deliveries", params={"state": "delivered"}).json()
    assert delivery["body"].encode() == received.body
    assert [one["status"] for one in delivery["attempts"]] == [204]
    assert "secret" not in api.http.get(path).json()
    assert api.http.delete(path).status_code == 204
    assert api.http.get(path).status_code == 404


def test_the_command_line_makes_tries_and_deletes(api: LiveApi, told: Receiver, tmp_path: Path) -> None:
    def wibam(*arguments: str) -> str:
        result = CliRunner().invoke(app, list(arguments), env={"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN})
        assert result.exit_code == 0, result.output
        return result.output

    site = api.site(cameras=1)
    hook, secret = wibam("create", told.url, "--site", site, "--event", "job.failed", "--name", "mine").split()
    assert secret.startswith("whsec_")
    delivery = wibam("ping", hook).strip()
    wait_until(lambda: "delivered" in wibam("log", hook))
    assert delivery == wibam("again", hook, delivery).strip()
    assert any(hook in line and site in line and "mine" in line for line in wibam("list").splitlines())
    wait_until(lambda: len(told.got) == 2)
    wibam("delete", hook)
    assert hook not in wibam("list")


def test_rests_when_it_is_told_to(api: LiveApi, told: Receiver) -> None:
    hook = api.http.post("/v1/webhooks", json={"url": told.url}).json()["id"]
    changed = api.http.patch(f"/v1/webhooks/{hook}", json={"active": False, "events": ["job.failed"]}).json()
    assert (changed["active"], changed["events"]) == (False, ["job.failed"])
    api.http.post(f"/v1/webhooks/{hook}/ping")
    assert api.services.webhook_sender.send_due() == 0
    assert [one["state"] for one in api.http.get(f"/v1/webhooks/{hook}/deliveries").json()] == ["pending"]
    api.http.delete(f"/v1/webhooks/{hook}")


@pytest.mark.parametrize(
    ("body", "status", "code"),
    [
        ({"url": "http://10.0.0.1/"}, 422, "address_refused"),
        ({"url": "file:///etc/passwd"}, 422, "invalid_input"),
        ({"url": "https://example.org", "events": []}, 422, "invalid_input"),
        ({"url": "https://example.org", "events": ["job.exploded"]}, 422, "invalid_input"),
        ({"url": "https://example.org", "site_id": "site_0"}, 404, "not_found"),
        ({"url": "https://example.org", "job_id": "job_0"}, 404, "not_found"),
    ],
)
def test_what_cannot_be_is_refused(api: LiveApi, body: dict[str, Any], status: int, code: str) -> None:
    answer = api.http.post("/v1/webhooks", json=body)
    assert (answer.status_code, answer.json()["code"]) == (status, code)


def test_a_key_that_only_reads_makes_and_sees_none(api: LiveApi) -> None:
    key = api.http.post("/v1/keys", json={"name": "reader", "scopes": ["read"]}).json()["secret"]
    headers = {"Authorization": f"Bearer {key}"}
    body = {"url": "https://example.org"}
    assert httpx.post(f"{api.url}/v1/webhooks", json=body, headers=headers, timeout=300).status_code == 403
    assert httpx.get(f"{api.url}/v1/webhooks", headers=headers, timeout=300).status_code == 403
