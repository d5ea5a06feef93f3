"""The picture of a site from above: sent, decoded apart, placed, and shown to whoever may see a job."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tests.builders import corner_rig, site_of
from tests.finished import finished_job
from tests.service import LiveApi
from tests.unit.formats.test_map_pictures import KEYS, SCALE, TIEPOINT, keys, write_tiff
from wibam_core.site import Origin


def png(width: int = 60, height: int = 40) -> bytes:
    buffer = io.BytesIO()
    Image.new("RGB", (width, height), (200, 30, 30)).save(buffer, "PNG")
    return buffer.getvalue()


def sent(api: LiveApi, site: str, data: bytes, name: str = "map.png", purpose: str = "map") -> str:
    """Upload a file; returns its id."""
    begun = api.begin(site, len(data), "", purpose=purpose, filename=name)
    assert begun.status_code == 201, begun.text
    assert api.send(begun.headers["Location"], 0, data).status_code == 204
    return str(begun.headers["Location"].rpartition("/")[2])


def put(api: LiveApi, site: str, **body: Any) -> Any:
    return api.http.put(f"/v1/sites/{site}/map", json=body)


def test_a_picture_is_kept_placed_and_taken_away(api: LiveApi) -> None:
    site = api.site()
    assert api.http.get(f"/v1/sites/{site}").json()["map"] is None
    assert api.http.get(f"/v1/sites/{site}/map").status_code == 404
    file = sent(api, site, png())
    taken = put(api, site, file=file).json()
    assert taken["map"] == {
        "filename": "map.png", "width_px": 60, "height_px": 40, "sent_width_px": 60, "sent_height_px": 40,
        "placing": None, "placed_by": "nothing", "origin": None,
    }  # fmt: skip
    assert api.http.get(f"/v1/sites/{site}/recordings").json() == [], "the upload is used up"
    picture = api.http.get(f"/v1/sites/{site}/map")
    assert picture.headers["content-type"] == "image/jpeg"
    red = np.asarray(Image.open(io.BytesIO(picture.content)))[5, 5]
    assert red[0] > 180 and red[1] < 60
    world = {"pixel": [9, 19], "world": [0, 0]}, {"pixel": [29, 19], "world": [10, 0]}
    placed = put(api, site, points=world).json()
    np.testing.assert_allclose(placed["map"]["placing"], [[0.5, 0, -4.5], [0, -0.5, 9.5]], atol=1e-9)
    assert placed["map"]["placed_by"] == "points" and placed["version"] != taken["version"]
    assert api.http.get(f"/v1/sites/{site}").json()["map"] == placed
    again = api.http.get(f"/v1/sites/{site}/map", headers={"If-None-Match": f'"{placed["version"]}"'})
    assert again.status_code == 304
    assert put(api, site, world_file="1\n0\n0\n-1\n7\n8").json()["map"]["placing"] == [[1, 0, 7], [0, -1, 8]]
    assert api.http.delete(f"/v1/sites/{site}/map").status_code == 204
    assert api.http.get(f"/v1/sites/{site}").json()["map"] is None


def test_a_world_file_is_that_of_the_picture_as_it_was_sent(api: LiveApi) -> None:
    site = api.site()
    found = put(api, site, file=sent(api, site, png(8192, 64)), world_file="0.1\n0\n0\n-0.1\n0.05\n-0.05").json()["map"]
    assert (found["width_px"], found["height_px"], found["sent_width_px"]) == (4096, 32, 8192)
    np.testing.assert_allclose(found["placing"], [[0.2, 0, 0.1], [0, -0.2, -0.1]], atol=1e-9)


def test_a_geotiff_lies_on_earth_where_the_site_does(api: LiveApi, tmp_path: Path) -> None:
    """UTM zone 32: at its central meridian, 9 degrees east, easting is 500,000 m and grid north is north."""
    tags = {SCALE: (0.5, 0.5, 0.0), TIEPOINT: (0.0, 0.0, 0.0, 500_000.0, 5_400_000.0, 0.0)}
    data = write_tiff(tmp_path / "o.tif", {**tags, KEYS: keys((1025, 1), (3072, 32632))}).read_bytes()
    origin = Origin(latitude_deg=48.753, longitude_deg=9.0)
    described = site_of(corner_rig(2)).model_copy(update={"origin": origin})
    site = api.http.post("/v1/sites", json=described.model_dump(mode="json")).json()["id"]
    found = put(api, site, file=sent(api, site, data, "o.tif")).json()["map"]
    assert found["placed_by"] == "GeoTIFF"
    (a, b, c), (d, e, _) = found["placing"]
    np.testing.assert_allclose([a, b, d, e], np.array([0.5, 0, 0, -0.5]) / 0.9996, atol=1e-4)
    assert c == pytest.approx(0.25 / 0.9996, abs=0.01), "the corner of its first pixel lies on the meridian"
    degrees = {SCALE: (1e-6, 1e-6, 0.0), TIEPOINT: (0.0, 0.0, 0.0, 9.0, 48.7, 0.0), KEYS: keys((2048, 4326))}
    site = api.site()
    refused = put(api, site, file=sent(api, site, write_tiff(tmp_path / "d.tif", degrees).read_bytes()))
    assert refused.status_code == 422 and "are not in metres" in refused.json()["detail"]


def test_what_lies_nowhere_on_earth_replaces_nothing(api: LiveApi, tmp_path: Path) -> None:
    origin = Origin(latitude_deg=48.0, longitude_deg=11.0)
    described = site_of(corner_rig(2)).model_copy(update={"origin": origin})
    on_earth = api.http.post("/v1/sites", json=described.model_dump(mode="json")).json()["id"]
    before = put(api, on_earth, file=sent(api, on_earth, png())).json()
    fine, metres = (1e-6, 1e-6, 0.0), (0.5, 0.5, 0.0)
    for site, scale, tie, key in (
        (on_earth, fine, (48.0, 111.0), (2048, 4326)),  # latitude and longitude swapped
        (on_earth, fine, (48.0, 11.0), (2048, 4326)),  # swapped, too: in Somalia
        (on_earth, metres, (1e300, 1e300), (3072, 32632)),
        (on_earth, (1e308, 1e308, 0.0), (5e5, 5e6), (3072, 32632)),
        (on_earth, metres, (5e5, 5e6), (3072, 5773)),  # heights above a geoid
        (api.site(), metres, (1e300, 1e300), (3072, 32632)),
        (api.site(), metres, (5e5, 5e6), (3072, 5773)),
    ):
        tags = {SCALE: scale, TIEPOINT: (0.0, 0.0, 0.0, *tie, 0.0), KEYS: keys((1025, 1), key)}
        data = write_tiff(tmp_path / "o.tif", tags).read_bytes()
        refused = put(api, site, file=sent(api, site, data, "o.tif"))
        assert refused.status_code == 422, (tie, key)
        assert "coordinate" in refused.json()["detail"] and "world file" in refused.json()["hint"]
    far = sent(api, on_earth, png(30, 30))
    assert put(api, on_earth, file=far, world_file="1e308\n0\n0\n-1e308\n0\n0").status_code == 422
    assert api.http.get(f"/v1/sites/{on_earth}").json()["map"] == before
    told = put(api, on_earth, file=sent(api, on_earth, data, "o.tif"), world_file="1\n0\n0\n-1\n7\n8").json()["map"]
    assert told["placing"] == [[1, 0, 7], [0, -1, 8]], "whoever says where it lies is believed before the file"


def test_what_is_no_map_is_refused(api: LiveApi) -> None:
    site = api.site()
    large = api.begin(site, 200_000_000, "", purpose="map", filename="map.png")
    assert (large.status_code, large.json()["detail"]) == (413, "the picture has 200 MB; a map may have 100 MB")
    refused = put(api, site, file=sent(api, site, b"no picture at all"))
    assert refused.status_code == 422 and "no picture" in refused.json()["detail"]
    labels = sent(api, site, png(), purpose="labels")
    assert "uploaded as labels" in put(api, site, file=labels).json()["detail"]
    assert put(api, site, file="file_0123456789abcdef").status_code == 404
    assert put(api, site, world_file="1\n0\n0\n-1\n0\n0").status_code == 404, "there is nothing to place"
    assert put(api, site).status_code == 422


def test_a_job_shows_it_and_never_works_with_it(api: LiveApi) -> None:
    job = finished_job(api, b"with a map")
    site = api.http.get(f"/v1/jobs/{job}").json()["site_id"]
    assert api.http.get(f"/v1/jobs/{job}/scene").json()["map"] is None
    kept = put(api, site, file=sent(api, site, png()), world_file="1\n0\n0\n-1\n0\n0").json()
    assert api.http.get(f"/v1/jobs/{job}/scene").json()["map"] == kept
    assert api.http.get(f"/v1/jobs/{job}/map").content == api.http.get(f"/v1/sites/{site}/map").content
    sent(api, site, png())  # one that nobody has taken yet
    assert [file["purpose"] for file in api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["files"]] == [
        "recording"
    ]


def test_a_map_lies_where_it_was_placed_in_no_other_world(api: LiveApi, tmp_path: Path) -> None:
    """The job is older than the site's origin: the GeoTIFF, which that origin laid, has no place beside its tracks."""
    job = finished_job(api, b"older than the origin")
    site = api.http.get(f"/v1/jobs/{job}").json()["site_id"]
    plain = api.http.get(f"/v1/sites/{site}").json()["site"]
    here = {**plain, "origin": {"latitude_deg": 48.753, "longitude_deg": 9.0}}
    api.http.put(f"/v1/sites/{site}", json=here)
    tags = {SCALE: (0.5, 0.5, 0.0), TIEPOINT: (0.0, 0.0, 0.0, 500_000.0, 5_400_000.0, 0.0)}
    data = write_tiff(tmp_path / "o.tif", {**tags, KEYS: keys((1025, 1), (3072, 32632))}).read_bytes()
    placed = put(api, site, file=sent(api, site, data, "o.tif")).json()
    assert placed["map"]["placing"] is not None and placed["note"] == ""
    beside = api.http.get(f"/v1/jobs/{job}/scene").json()["map"]
    assert beside["map"]["placing"] is None and "o.tif has no place here" in beside["note"]
    for change, shown in (
        ({"longitude_deg": 9.1}, False),
        ({"x_axis_bearing_deg": 80.0}, False),
        ({"epsg": 25832}, True),
    ):
        changed = {**here, "origin": {**here["origin"], **change}}
        said = api.http.put(f"/v1/sites/{site}", json=changed).json()["map"]
        assert (said["map"]["placing"] is not None) == shown == (said["note"] == ""), change
    by_hand = put(api, site, world_file="1\n0\n0\n-1\n0\n0").json()
    api.http.put(f"/v1/sites/{site}", json=plain)
    assert api.http.get(f"/v1/sites/{site}").json()["map"] == by_hand, "this place is the world's own"
