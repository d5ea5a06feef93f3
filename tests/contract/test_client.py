"""The Python client's patience, and the way it takes to the service."""

from __future__ import annotations

import pytest

from tests.finished import finished_job
from tests.service import TOKEN, LiveApi
from wibam_core.client import JobView, WibamClient
from wibam_core.client.connection import is_this_machine
from wibam_core.errors import ServiceUnavailable


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


class TestWaiting:
    @pytest.fixture
    def failing(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        """The service does not answer three times."""
        failures: list[str] = []
        look = WibamClient.job

        def sometimes(self: WibamClient, job_id: str) -> JobView:
            if len(failures) < 3:
                failures.append(job_id)
                raise ServiceUnavailable("it has just been restarted")
            return look(self, job_id)

        monkeypatch.setattr(WibamClient, "job", sometimes)
        return failures

    def test_puts_up_with_a_service_that_is_away_for_a_moment(self, api: LiveApi, job: str, failing: list[str]) -> None:
        with WibamClient(api.url, TOKEN) as client:
            assert client.wait(job, interval_s=0.01).state.is_terminal
        assert len(failing) == 3

    def test_but_not_for_ever(self, api: LiveApi, job: str, failing: list[str]) -> None:
        with WibamClient(api.url, TOKEN, patience_s=0.0) as client, pytest.raises(ServiceUnavailable):
            client.wait(job, interval_s=0.01)

    def test_ends_when_the_check_says_so(self, api: LiveApi) -> None:
        site = api.site(cameras=1)
        api.upload(site, b"no worker ever looks at it")
        looks: list[int] = []

        def check() -> None:
            looks.append(len(looks))
            if len(looks) == 3:
                raise ServiceUnavailable("the worker keeps dying")

        with WibamClient(api.url, TOKEN) as client:
            waiting = client.create_job(site)
            with pytest.raises(ServiceUnavailable, match="keeps dying"):
                client.wait(waiting.id, check=check, interval_s=0.01)


def test_no_proxy_is_asked_for_a_service_on_this_machine(api: LiveApi, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    with WibamClient(api.url, TOKEN) as client:
        client.sites()


@pytest.mark.parametrize(
    ("host", "here"),
    [("127.0.0.1", True), ("127.8.8.8", True), ("::1", True), ("localhost", True), ("0.0.0.0", True),
     ("10.0.0.1", False), ("example.org", False), ("localhost.example.org", False)],
)  # fmt: skip
def test_which_hosts_are_this_machine(host: str, here: bool) -> None:
    assert is_this_machine(host) == here
