"""Site descriptions: what is refused, and in which words."""

from __future__ import annotations

import json

import pytest

from tests.builders import site_of
from wibam_core.errors import SiteFileError
from wibam_core.site import Site


def test_a_site_survives_json() -> None:
    site = site_of()
    assert Site.parse(site.model_dump_json()) == site


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s["cameras"][0].pop("id"), r"cameras\.0\.id"),
        (lambda s: s["cameras"][0].update(id="../etc"), r"cameras\.0\.id"),
        (lambda s: s["cameras"][1].update(id="CAM1"), "must differ"),
        (lambda s: s.update(cameras=[]), "cameras"),
        (lambda s: s["cameras"][0].update(lens="wide"), r"cameras\.0\.lens"),
        (lambda s: s["cameras"][0]["calibration"].update(kind="magic"), r"cameras\.0\.calibration"),
        (lambda s: s["cameras"][0]["calibration"]["tvec"].__setitem__(0, None), "tvec"),
    ],
)
def test_the_first_wrong_field_is_named(change, words: str) -> None:  # type: ignore[no-untyped-def]
    data = json.loads(site_of().model_dump_json())
    change(data)
    with pytest.raises(SiteFileError, match=words):
        Site.parse(json.dumps(data))


def test_text_that_is_no_json_is_refused() -> None:
    with pytest.raises(SiteFileError):
        Site.parse("{")
