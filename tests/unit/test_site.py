"""Site descriptions: what is refused, and in which words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.builders import corner_rig, site_of
from wibam_core.errors import SiteFileError
from wibam_core.site import Origin, Site, _check_epsg
from wibam_core.stages.runner import SiteFolder


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
        (lambda s: s["cameras"][0].update(lens="wide"), r"cameras\.0: there is no field 'lens'"),
        (lambda s: s["cameras"][0]["calibration"].update(kind="magic"), r"cameras\.0\.calibration"),
        (lambda s: s["cameras"][0]["calibration"]["tvec"].__setitem__(0, None), "tvec"),
    ],
)
def test_the_first_wrong_field_is_named(change, words: str) -> None:  # type: ignore[no-untyped-def]
    data = json.loads(site_of().model_dump_json())
    change(data)
    with pytest.raises(SiteFileError, match=words):
        Site.parse(json.dumps(data))


def _signal(*region: float) -> dict[str, object]:
    return {"id": "left", "region": region}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s["cameras"][1].update(signals=[_signal(10, 10, 0, 5)]), "camera cam2, signal left: .* is empty"),
        (lambda s: s["cameras"][1].update(signals=[_signal(10, 10, 5, -5)]), "camera cam2, signal left: .* is empty"),
        (lambda s: s["cameras"][1].update(signals=[_signal(640, 10, 5, 5)]), "signal left: .* outside .* 640x360"),
        (lambda s: s["cameras"][1].update(signals=[_signal(10, 400, 5, 5)]), "signal left: .* outside"),
        (lambda s: s["cameras"][1].update(signals=[_signal(-10, 10, 10, 5)]), "signal left: .* outside"),
        (lambda s: s["cameras"][0]["calibration"]["K"][0].__setitem__(0, 0.0), "camera cam1: .* not 0 and 500"),
        (lambda s: s["cameras"][0]["calibration"]["K"][1].__setitem__(1, -7.0), "camera cam1: .* not 500 and -7"),
        (lambda s: s.update(name="a\0b"), "control character"),
    ],
)
def test_what_no_recording_can_fit_is_refused(change, words: str) -> None:  # type: ignore[no-untyped-def]
    data = json.loads(site_of().model_dump_json())
    change(data)
    with pytest.raises(SiteFileError, match=words) as refused:
        Site.parse(json.dumps(data))
    assert refused.value.hint


def test_a_region_that_ends_beyond_the_image_is_fine() -> None:
    data = json.loads(site_of().model_dump_json())
    data["cameras"][0]["signals"] = [_signal(630, 350, 20, 20), _signal(-5, -5, 10, 20)]
    assert len(Site.parse(json.dumps(data)).cameras[0].signals) == 2


def test_two_recordings_of_a_camera_are_both_named(tmp_path: Path) -> None:
    (tmp_path / "site.json").write_text(site_of(corner_rig(2)).model_dump_json())
    (tmp_path / "recordings").mkdir()
    for name in ("cam1.mp4", "cam2.mp4", "cam2.mov"):
        (tmp_path / "recordings" / name).write_bytes(b"x")
    with pytest.raises(SiteFileError, match=r"camera cam2 .*: cam2\.mov, cam2\.mp4"):
        SiteFolder.load(tmp_path)
    (tmp_path / "recordings" / "cam2.mov").unlink()
    assert [file.name for file in SiteFolder.load(tmp_path).recordings["cam2"].files] == ["cam2.mp4"]


def test_a_calibration_of_another_picture_size_is_refused() -> None:
    data = json.loads(site_of().model_dump_json())
    camera = data["cameras"][0]
    camera["calibration"]["picture_px"] = [camera["width_px"], camera["height_px"]]
    assert Site.parse(json.dumps(data)).cameras[0].calibration.picture_px == (camera["width_px"], camera["height_px"])
    camera["calibration"]["picture_px"] = [2 * camera["width_px"], 2 * camera["height_px"]]
    with pytest.raises(SiteFileError, match="camera cam1: its calibration was made on") as refused:
        Site.parse(json.dumps(data))
    assert "by 0.5 across" in refused.value.hint


def test_text_that_is_no_json_is_refused() -> None:
    with pytest.raises(SiteFileError):
        Site.parse("{")


@pytest.mark.parametrize(
    ("origin", "words"),
    [
        ({"latitude_deg": 91, "longitude_deg": 0}, r"origin\.latitude_deg"),
        ({"latitude_deg": 0}, r"origin\.longitude_deg"),
        ({"latitude_deg": 0, "longitude_deg": 0, "epsg": 4326}, "EPSG:4326 is no projected"),
        ({"latitude_deg": 0, "longitude_deg": 0, "epsg": 2263}, "EPSG:2263 .* in metres"),  # US survey feet
        ({"latitude_deg": 0, "longitude_deg": 0, "epsg": 1999}, "EPSG:1999"),
    ],
)
def test_an_origin_that_is_nowhere_on_earth_is_refused(origin: dict[str, float], words: str) -> None:
    data = {**json.loads(site_of().model_dump_json()), "origin": origin}
    with pytest.raises(SiteFileError, match=words):
        Site.parse(json.dumps(data))


def test_a_site_may_say_where_it_lies() -> None:
    origin = {
        "latitude_deg": 48.1,
        "longitude_deg": 11.5,
        "altitude_m": 519.0,
        "x_axis_bearing_deg": 72.5,
        "epsg": 25832,
    }
    site = Site.parse(json.dumps({**json.loads(site_of().model_dump_json()), "origin": origin}))
    assert site.origin is not None and site.origin.model_dump() == origin


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("id", "S\u00fcd", "letter from a to z"),
        ("signal", [], "there is no field 'signal' here; is signals meant?"),
        ("Width_px", 640, "is width_px meant?"),
        ("colour", "red", "there is no field 'colour' here$"),
    ],
)
def test_what_no_camera_has_is_named_with_what_may_be_meant(field: str, value: object, words: str) -> None:
    camera = {
        "id": "a",
        "width_px": 640,
        "height_px": 360,
        "calibration": {"kind": "homography", "correspondences": []},
    }
    with pytest.raises(SiteFileError, match=words):
        Site.parse(json.dumps({"name": "t", "cameras": [camera | {field: value}]}))


@pytest.mark.parametrize(
    ("field", "meant"), [("distortion", "dist"), ("k", "K"), ("R", "rvec"), ("lens_model", "lens")]
)
def test_fields_that_other_programs_call_otherwise_are_named(field: str, meant: str) -> None:
    calibration = {"kind": "matrices", "K": [[600, 0, 320], [0, 600, 180], [0, 0, 1]], "tvec": [0, 2, 15], field: 1}
    camera = {"id": "a", "width_px": 640, "height_px": 360, "calibration": calibration}
    with pytest.raises(SiteFileError, match=f"'{field}' here; is {meant} meant"):
        Site.parse(json.dumps({"name": "t", "cameras": [camera]}))


@pytest.mark.parametrize(
    ("latitude", "longitude", "epsg", "words"),
    [(48.1, 11.6, 32610, "EPSG:32610"), (11.6, 48.1, 25832, "EPSG:25832")],
)
def test_an_origin_far_from_where_its_system_is_used_is_refused(
    latitude: float, longitude: float, epsg: int, words: str
) -> None:
    data = json.loads(site_of().model_dump_json())
    data["origin"] = {"latitude_deg": latitude, "longitude_deg": longitude, "epsg": epsg}
    with pytest.raises(SiteFileError, match=words) as caught:
        Site.parse(json.dumps(data))
    assert ("exchanged" in caught.value.hint) == (epsg == 25832)
    data["origin"] = {"latitude_deg": 48.1, "longitude_deg": 11.6, "epsg": 25832}
    Site.parse(json.dumps(data))


@pytest.mark.parametrize(
    ("latitude", "longitude", "epsg"), [(52, 179.9, 32601), (52, -179.9, 32660), (-16.8, -179.9, 32760)]
)
def test_an_origin_across_the_antimeridian_is_near(latitude: float, longitude: float, epsg: int) -> None:
    _check_epsg(Origin(latitude_deg=latitude, longitude_deg=longitude, epsg=epsg), epsg)
