"""GeoJSON and projected CSV: places on Earth, against the ellipsoid's own equations and UTM's definition."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.exchange_content import content
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content
from wibam_core.exchange.earth import Earth
from wibam_core.exchange.geojson import GeoJson
from wibam_core.exchange.projected_csv import ProjectedCsv
from wibam_core.site import Origin

#: WGS 84: half the equator's diameter (m), flattening, and what follows from them.
A_M, F = 6378137.0, 1 / 298.257223563
E2 = F * (2 - F)


def ecef_m(lon_deg: np.ndarray, lat_deg: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Earth-centred coordinates (N, 3), by the definition of geodetic latitude."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    normal = A_M / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (normal + height_m) * np.cos(lat) * np.cos(lon),
            (normal + height_m) * np.cos(lat) * np.sin(lon),
            (normal * (1 - E2) + height_m) * np.sin(lat),
        ],
        axis=-1,
    )


def east_north_up_m(origin: Origin, lon_lat_height: np.ndarray) -> np.ndarray:
    """Positions (N, 3) as metres to the east, north and up of the origin."""
    lon, lat, height = np.radians(origin.longitude_deg), np.radians(origin.latitude_deg), origin.altitude_m or 0.0
    offset = ecef_m(*lon_lat_height.T) - ecef_m(np.degrees(lon), np.degrees(lat), np.array(height))
    east = [-np.sin(lon), np.cos(lon), 0.0]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return offset @ np.stack([east, np.cross(up, east), up]).T


def at(origin: Origin) -> Content:
    given_content = content()
    assert given_content.site is not None
    return replace(given_content, site=given_content.site.model_copy(update={"origin": origin}))


@given(st.floats(-80, 80), st.floats(-179, 179), st.floats(-100, 3000), st.floats(-200, 200), st.floats(-200, 200))
def test_a_world_whose_x_is_east_lies_as_the_ellipsoid_says(
    lat: float, lon: float, altitude: float, x: float, y: float
) -> None:
    origin = Origin(latitude_deg=lat, longitude_deg=lon, altitude_m=altitude)
    found = east_north_up_m(origin, Earth(origin).geographic(np.array([[x, y, 2.0]])))
    np.testing.assert_allclose(found, [[x, y, 2.0]], atol=1e-5)


def test_convention_the_bearing_of_x_is_clockwise_from_north() -> None:
    origin = Origin(latitude_deg=48.0, longitude_deg=11.0, altitude_m=0.0, x_axis_bearing_deg=180.0)
    earth = Earth(origin)
    # X points to the south; Y, to its left, to the east
    found = east_north_up_m(origin, earth.geographic(np.array([[10.0, 0.0, 0.0], [0.0, 10.0, 0.0]])))
    np.testing.assert_allclose(found, [[0, -10, 0], [10, 0, 0]], atol=1e-4)
    np.testing.assert_allclose(earth.bearing_deg(np.array([0.0, np.pi / 2, -np.pi / 2])), [180, 90, 270])


def test_on_a_central_meridian_at_the_equator_utm_is_the_plane_shrunk_by_its_scale() -> None:
    earth = Earth(Origin(latitude_deg=0.0, longitude_deg=9.0))
    assert earth.epsg == 32632  # 9° east is the middle of zone 32
    points = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0]])
    expected = [[500000.0, 0.0], [500099.96, 0.0], [500000.0, 99.96]]
    np.testing.assert_allclose(earth.projected(points), expected, atol=1e-4)
    np.testing.assert_allclose(earth.grid_angle_rad(points), 0, atol=1e-9)


def test_off_the_central_meridian_the_grid_turns_by_the_convergence() -> None:
    origin = Origin(latitude_deg=60.0, longitude_deg=11.0)
    convergence = np.arctan(np.tan(np.radians(2.0)) * np.sin(np.radians(60.0)))  # of the sphere, near enough
    # the grid's north lies east of true north there, so that true east is counter-clockwise from the easting axis
    assert Earth(origin).grid_angle_rad(np.zeros((1, 3)))[0] == pytest.approx(convergence, abs=1e-5)


def test_the_south_has_zones_of_its_own_and_the_poles_have_none() -> None:
    assert Earth(Origin(latitude_deg=-33.9, longitude_deg=151.2)).epsg == 32756
    with pytest.raises(InputError, match="no UTM zone at latitude 88"):
        _ = Earth(Origin(latitude_deg=88.0, longitude_deg=0.0)).epsg
    assert Earth(Origin(latitude_deg=88.0, longitude_deg=0.0, epsg=32661)).epsg == 32661


def test_geojson_has_a_line_a_track_and_a_point_a_state_on_the_ground(tmp_path: Path) -> None:
    origin = Origin(latitude_deg=48.1, longitude_deg=11.5, altitude_m=520.0)
    tracks = content().tracks or ()
    lines, points = (json.loads(path.read_text()) for path in GeoJson().write(at(origin), tmp_path))
    assert lines["type"] == points["type"] == "FeatureCollection"
    assert [f["geometry"]["type"] for f in lines["features"]] == ["LineString"] * 3
    assert len(points["features"]) == sum(len(track) for track in tracks)
    for feature, track in zip(lines["features"], tracks, strict=True):
        ground = track.boxes[:, :3] - [0, 0, 1] * track.boxes[:, 5:6] / 2
        found = east_north_up_m(origin, np.array(feature["geometry"]["coordinates"]))
        np.testing.assert_allclose(found, ground, atol=1e-3)
        assert feature["properties"]["time_ns"] == track.times_ns.tolist()
        assert feature["properties"]["class"] == track.vehicle_class.value
        np.testing.assert_allclose(
            feature["properties"]["bearing_deg"], (90 - np.degrees(track.boxes[:, 6])) % 360, atol=1e-3
        )
    first = points["features"][0]["properties"]
    assert (first["track_id"], first["speed_mps"], first["place_sd_m"]) == (10, 10.0, 0.1)


def test_geojson_is_flat_where_the_altitude_is_not_known_and_a_point_where_a_track_has_one_state(
    tmp_path: Path,
) -> None:
    flat = at(Origin(latitude_deg=48.1, longitude_deg=11.5))
    track = (flat.tracks or ())[0]
    one = {name: getattr(track, name)[:1] for name in ("times_ns", "boxes", "velocities_mps", "yaw_rates_radps")}
    flat = replace(flat, tracks=[replace(track, **one, sd=np.full((1, 7), np.nan))])
    lines, points = (json.loads(path.read_text()) for path in GeoJson().write(flat, tmp_path))
    (line,) = lines["features"]
    assert line["geometry"]["type"] == "Point" and len(line["geometry"]["coordinates"]) == 2
    assert points["features"][0]["properties"]["place_sd_m"] is None


def test_geopandas_reads_both_files_and_measures_the_path(tmp_path: Path) -> None:
    geopandas = pytest.importorskip("geopandas", reason="geopandas is not installed")
    lines, points = (
        geopandas.read_file(path) for path in GeoJson().write(at(Origin(latitude_deg=0.0, longitude_deg=9.0)), tmp_path)
    )
    assert lines.crs.to_epsg() == points.crs.to_epsg() == 4326
    assert lines["class"].tolist() == ["car", "van", "truck"]
    # the car drives four steps of 0.8 m; a metre on the ground is 0.9996 m of the map at UTM's central meridian
    assert lines.to_crs(32632).length.iloc[0] == pytest.approx(4 * 0.8 * 0.9996, abs=1e-3)
    assert points.groupby("track_id").size().tolist() == [5, 5, 5]


def rows(path: Path) -> list[dict[str, Any]]:
    return list(csv.DictReader(path.open()))


def test_csv_is_in_the_axes_of_the_grid(tmp_path: Path) -> None:
    # the world's X axis points north: its yaw 0 is a quarter turn from the easting axis
    (path,) = ProjectedCsv().write(at(Origin(latitude_deg=0.0, longitude_deg=9.0, x_axis_bearing_deg=0.0)), tmp_path)
    assert path.name == "tracks_epsg32632.csv"
    car = rows(path)[0]
    assert car["class"] == "car" and car["track_id"] == "10"
    # at world (-6, -2): 6 m south and 2 m east
    assert float(car["easting_m"]) == pytest.approx(500000 + 2 * 0.9996, abs=1e-3)
    assert float(car["northing_m"]) == pytest.approx(-6 * 0.9996, abs=1e-3)
    assert float(car["yaw_rad"]) == pytest.approx(np.pi / 2, abs=1e-5)
    assert float(car["v_northing_mps"]) == pytest.approx(10.0, abs=1e-4)
    assert float(car["v_easting_mps"]) == pytest.approx(0.0, abs=1e-4)


def test_csv_turns_standard_deviations_with_the_axes_and_leaves_unknown_ones_empty(tmp_path: Path) -> None:
    given_content = at(Origin(latitude_deg=0.0, longitude_deg=9.0, x_axis_bearing_deg=0.0))
    track = (given_content.tracks or ())[0]
    sd = np.tile([0.3, 0.1, np.nan, 0.1, 0.1, 0.1, 0.02], (5, 1))
    (path,) = ProjectedCsv().write(replace(given_content, tracks=[replace(track, sd=sd)]), tmp_path)
    first = rows(path)[0]
    assert (float(first["sd_northing_m"]), float(first["sd_easting_m"])) == pytest.approx((0.3, 0.1), abs=1e-5)
    assert (first["sd_z_m"], float(first["sd_yaw_rad"])) == ("", 0.02)


def test_csv_takes_the_system_that_the_site_names(tmp_path: Path) -> None:
    # ETRS89 / UTM 32N agrees with WGS 84 / UTM 32N within the metre by which Europe has drifted
    (own,) = ProjectedCsv().write(at(Origin(latitude_deg=48.1, longitude_deg=11.5, epsg=25832)), tmp_path)
    (utm,) = ProjectedCsv().write(at(Origin(latitude_deg=48.1, longitude_deg=11.5)), tmp_path)
    assert (own.name, utm.name) == ("tracks_epsg25832.csv", "tracks_epsg32632.csv")
    assert float(rows(own)[0]["easting_m"]) == pytest.approx(float(rows(utm)[0]["easting_m"]), abs=1.0)


@pytest.mark.parametrize("fmt", [GeoJson(), ProjectedCsv()], ids=["geojson", "projected-csv"])
def test_a_site_that_does_not_say_where_it_lies_is_told_how(fmt: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without origin") as refused:
        fmt.write(content(), tmp_path)
    assert "site.json" in refused.value.hint
