"""What clients of tus send beyond the plain case: methods in a header, first bytes along, proxies, other origins."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.service import LiveApi, live_api, settings_for

DATA = bytes(range(200))
TUS = {"Tus-Resumable": "1.0.0"}
BYTES = {"Content-Type": "application/offset+octet-stream"}
ORIGIN = "https://app.example"


@pytest.fixture(scope="module")
def site(api: LiveApi) -> str:
    return api.site()


@pytest.fixture(scope="module")
def open_api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    with live_api(settings_for(tmp_path_factory.mktemp("open"), cors_origins=(ORIGIN,))) as running:
        yield running


@pytest.fixture
def upload(api: LiveApi, site: str) -> str:
    return str(api.begin(site, len(DATA)).headers["Location"])


def offset(api: LiveApi, upload: str) -> str:
    return str(api.http.head(upload, headers=TUS).headers["Upload-Offset"])


def test_a_post_may_name_the_method_in_a_header(api: LiveApi, upload: str) -> None:
    patch = {**TUS, **BYTES, "X-HTTP-Method-Override": "PATCH", "Upload-Offset": "0"}
    assert api.http.post(upload, headers=patch, content=DATA[:50]).status_code == 204
    assert offset(api, upload) == "50"
    delete = {**TUS, "X-HTTP-Method-Override": "delete"}
    assert api.http.post(upload, headers=delete).status_code == 204
    assert api.http.head(upload, headers=TUS).status_code in (404, 410)


def test_no_other_method_and_no_other_address_is_overridden(api: LiveApi, site: str, upload: str) -> None:
    put = api.http.post(upload, headers={**TUS, "X-HTTP-Method-Override": "PUT"})
    assert put.status_code == 405
    assert api.http.post(f"/v1/sites/{site}", headers={"X-HTTP-Method-Override": "DELETE"}).status_code == 405
    assert api.http.get(f"/v1/sites/{site}").status_code == 200


@pytest.mark.parametrize("count", [0, 60, len(DATA)])
def test_the_first_bytes_may_come_along(api: LiveApi, site: str, count: int) -> None:
    begun = api.begin(site, len(DATA), body=DATA[:count])
    assert begun.status_code == 201
    assert begun.headers["Upload-Offset"] == str(count)
    upload = begun.headers["Location"]
    if count < len(DATA):
        assert offset(api, upload) == str(count)
        rest = {**TUS, **BYTES, "Upload-Offset": str(count)}
        assert api.http.patch(upload, headers=rest, content=DATA[count:]).status_code == 204
    stored = (api.services.folder.root / "files" / Path(upload).name).read_bytes()
    assert stored == DATA


def test_more_bytes_than_announced_do_not_come_along(api: LiveApi, site: str) -> None:
    assert api.begin(site, 10, body=DATA).status_code in (409, 413)


@pytest.mark.parametrize(
    ("forwarded", "prefix"),
    [("/traffic", "/traffic"), ("/a/b/", "/a/b"), ("//evil.example", ""), ("https://evil.example", ""), ("/a b", "")],
)
def test_addresses_have_the_prefix_of_the_proxy(api: LiveApi, site: str, forwarded: str, prefix: str) -> None:
    location = api.begin(site, 10, extra={"X-Forwarded-Prefix": forwarded}).headers["Location"]
    assert location.startswith(f"{prefix}/v1/uploads/")


#: What a browser asks before a page of another origin may send bytes.
ASKED = {
    "Origin": ORIGIN,
    "Access-Control-Request-Method": "PATCH",
    "Access-Control-Request-Headers": "authorization,tus-resumable,upload-offset",
}


class TestOtherOrigins:
    def test_pages_of_a_named_origin_may_upload(self, open_api: LiveApi) -> None:
        answer = httpx.options(f"{open_api.url}/v1/uploads/x", headers=ASKED)
        assert answer.status_code == 200
        assert answer.headers["Access-Control-Allow-Origin"] == ORIGIN
        assert "PATCH" in answer.headers["Access-Control-Allow-Methods"]
        begun = open_api.begin(open_api.site(), 10, extra={"Origin": ORIGIN})
        shown = begun.headers["Access-Control-Expose-Headers"]
        assert all(name in shown for name in ("Location", "Upload-Offset", "Tus-Resumable"))
        wrong = httpx.get(f"{open_api.url}/v1/jobs", headers={"Origin": ORIGIN}, timeout=300)
        assert wrong.status_code == 401 and wrong.headers["Access-Control-Allow-Origin"] == ORIGIN

    def test_pages_of_others_may_not(self, open_api: LiveApi, api: LiveApi) -> None:
        other = httpx.options(f"{open_api.url}/v1/uploads", headers={**ASKED, "Origin": "https://evil.example"})
        assert "Access-Control-Allow-Origin" not in other.headers
        assert "Access-Control-Allow-Origin" not in httpx.options(f"{api.url}/v1/uploads", headers=ASKED).headers
