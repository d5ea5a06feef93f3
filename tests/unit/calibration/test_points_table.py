"""Surveyed points in tables, as surveyors, spreadsheets and scripts of many countries save them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.unit.calibration.test_foreign import (
    GROUND,
    PIXELS,
    camera_of,
    kalibr_file,
    on_earth,
    origin_at,
    saved,
    told,
)
from wibam_core.calibration.foreign.registry import read_file, read_named
from wibam_core.calibration.foreign.to_site import describe
from wibam_core.errors import InputError
from wibam_core.site import PnPCalibration

GRID = GROUND + [691_234.5, 5_334_567.25, 0.0]


def table(header: str, delimiter: str = ",", decimal: str = ".", places: np.ndarray = GRID, end: str = "\n") -> str:
    rows = [
        delimiter.join(f"{value:.9f}".replace(".", decimal) for value in (*place, *pixel))
        for place, pixel in zip(places, PIXELS, strict=True)
    ]
    return end.join([header.replace(",", delimiter), *rows, ""])


@pytest.mark.parametrize(
    ("text", "name"),
    [
        (table("x,y,z,u,v"), "points.csv"),
        (table("Easting,NORTHING,Height,U,V", ";", ","), "points.csv"),
        (table("X [m],Y [m],Z (m),u_px,v_px", "\t", ",", end="\r\n"), "points.txt"),
        ("# made on Monday\n\n" + table('"x_m","y_m","z_m","u","v"') + "\n// the end\n", "p.csv"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_tables_of_any_spreadsheet_say_the_same_points(text: str, name: str, encoding: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(text.encode(encoding))
    form, [camera] = read_file(tmp_path / name)
    assert form == "table of points" and camera.points is not None and camera.points.crs is None
    np.testing.assert_allclose(camera.points.coordinates, GRID, atol=1e-6)
    np.testing.assert_allclose(camera.points.pixels, PIXELS, atol=1e-6)


def test_longitudes_and_latitudes_calibrate_a_camera(tmp_path: Path) -> None:
    places = np.column_stack([on_earth(GROUND[:, :2]), GROUND[:, 2]])
    points = saved(tmp_path, "points.csv", table("lon,lat,z,u,v", ";", ",", places))
    site = tmp_path / "site"
    origin_at(site)
    told(site, "north", kalibr_file(tmp_path), points)
    calibration = camera_of(site, "north")[1].calibration
    assert isinstance(calibration, PnPCalibration)
    np.testing.assert_allclose([one.world for one in calibration.correspondences], GROUND, atol=2e-3)


BOTH = "lon,lat,easting,northing,u,v\n11.57,48.14,691234.5,5334567.25,30,40\n"


@pytest.mark.parametrize(
    ("line", "place", "crs"),
    [
        ("#CRS: EPSG:25832\n", [691_234.5, 5_334_567.25], "EPSG:25832"),
        ("# crs : EPSG:4258\n", [11.57, 48.14], "EPSG:4258"),
        ("", [11.57, 48.14], "EPSG:4326"),
    ],
)
def test_of_two_pairs_of_places_the_one_counts_that_the_system_is_of(line: str, place: list[float], crs: str) -> None:
    [camera] = read_named("gcp.csv", line + BOTH)[1]
    assert camera.points is not None and camera.points.crs == crs
    np.testing.assert_array_equal(camera.points.coordinates[0, :2], place)
    names = ("lon and lat", "easting and northing")
    used, left = names if place[0] < 180 else names[::-1]
    assert camera.notes == (f"Places are {used} in {crs}; {left} were left out.",)


def test_rows_of_several_cameras_and_points_without_a_pixel() -> None:
    text = "name,camera,x,y,u,v\np1,north,1,2,30,40\np2,south,1,2,50,60\np3,north,5,6,,\n"
    found = {camera.name: camera for camera in read_named("gcp.csv", text)[1]}
    assert sorted(found) == ["north", "south"]
    assert found["north"].notes == ("1 points without a pixel were left out.",)
    assert found["south"].points is not None and np.isnan(found["south"].points.coordinates[0, 2])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x;y;u;v\n691.234,5;1;2;3\n", "line 2, x: '691.234,5' has its thousands set apart"),
        ("x,y,u,v\n691'234.5,1,2,3\n", "thousands set apart"),
        ("x,y,u,v\n1,5,2,3,4,5\n", "line 2 has 6 columns, the line of names has 4"),
        ("x,y,u,v\n1,2,three,4\n", "line 2, u: 'three' is no number"),
        ("x,y,u,v\n1,2,nan,4\n", "not finite"),
        ("east,u,v\n1,2,3\n", "no two columns of places"),
        ("x,X,y,u,v\n1,1,2,3,4\n", "two columns x"),
        (
            "#CRS: EPSG:25832\nlon,lat,u,v\n11.57,48.14,3,4\n",
            "has lon and lat, but names EPSG:25832, which has neither",
        ),
        ("#CRS: EPSG:4978\nlon,lat,u,v\n11.57,48.14,3,4\n", "but names EPSG:4978"),
        ("#CRS: Gauss\nlon,lat,u,v\n11.57,48.14,3,4\n", "system Gauss is not known"),
    ],
)
def test_tables_that_cannot_be_understood_are_refused_with_the_place(text: str, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(words)) as refused:
        read_named("points.csv", text)
    assert refused.value.hint


@pytest.mark.parametrize(
    ("easting", "hint"),
    [("5.334.567,25", "plain numbers"), ("5334567,2.5", "plain numbers"), ("48.137 N", "decimal degrees")],
)
def test_what_is_no_number_is_told_apart_from_degrees(easting: str, hint: str) -> None:
    with pytest.raises(InputError) as refused:
        read_named("points.csv", f"easting;northing;u;v\n{easting};1;2;3\n")
    assert hint in str(refused.value.hint)


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ","), ("\t", ",")])
def test_points_of_qgis_that_a_spreadsheet_saved_again(delimiter: str, decimal: str) -> None:
    lines = ["mapX,mapY,sourceX,sourceY,enable".replace(",", delimiter)]
    for place, pixel in zip(GRID, PIXELS, strict=True):
        numbers = [*place[:2], pixel[0] + 0.5, -(pixel[1] + 0.5)]
        lines.append(delimiter.join([*(f"{value:.9f}".replace(".", decimal) for value in numbers), "1"]))
    form, [camera] = read_named("north.points", "\n".join(["#CRS: EPSG:32632", *lines]))
    assert form == "QGIS points" and camera.points is not None and camera.points.crs == "EPSG:32632"
    np.testing.assert_allclose(camera.points.pixels, PIXELS, atol=1e-6)
    np.testing.assert_allclose(camera.points.coordinates[:, :2], GRID[:, :2], atol=1e-6)


def test_a_file_that_is_called_json_and_is_none_is_refused_with_the_place() -> None:
    text = '{"type": "FeatureCollection",\n "features": [] // none yet\n}'
    with pytest.raises(InputError, match=r"line 2, .* no comments"):
        read_named("points.geojson", text)


@pytest.mark.parametrize(
    "header",
    [
        "East,North,z,col,row",
        "Rechtswert,Hochwert,z,u,v",
        "X_world,Y_world,z,x_img,y_img",
        "Easting,Northing,z,Pixel,Line",
        "easting,northing,z,x,y",
        "world_x [m],world_y [m],z [m],image_x,image_y",
    ],
)
def test_columns_are_known_by_what_programs_call_them(header: str) -> None:
    _, [found] = read_named("a.csv", table(header))
    assert found.points is not None
    np.testing.assert_allclose(found.points.coordinates, GRID, atol=1e-6)
    np.testing.assert_allclose(found.points.pixels, PIXELS, atol=1e-6)


def test_columns_may_be_set_apart_by_blanks() -> None:
    text = table("x,y,z,u,v", "\t").replace("\t", "   ")
    _, [found] = read_named("a.txt", text)
    assert found.points is not None
    np.testing.assert_allclose(found.points.pixels, PIXELS, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("lat,lon,z,u,v\n48°08'13.2\"N,11°34'11\"E,0,10,20\n", "decimal degrees"),
        ("691234.5,5334567.2,10,20\n", "line of names"),
        ("x,y,z,note\n1,2,0,kerb\n", "Call them u and v"),
    ],
)
def test_what_a_table_lacks_is_said_with_what_helps(text: str, words: str) -> None:
    with pytest.raises(InputError) as refused:
        read_named("a.csv", text)
    assert words in refused.value.hint


def test_points_far_outside_of_where_their_system_is_used_are_refused() -> None:
    """Metres of a zone in Germany, said to be feet of New York: the plane is stretched there to no metres at all."""
    text = "#CRS: EPSG:2263\n" + table("easting,northing,z,u,v", places=GRID / 0.3048)
    _, [found] = read_named("p.csv", text)
    with pytest.raises(InputError, match=r"EPSG:2263 is used \(United States") as refused:
        describe("a", [found], (1280, 720), None, None)
    assert "swapped" in refused.value.hint


def test_metres_that_are_said_to_be_degrees_are_refused() -> None:
    _, [found] = read_named("p.csv", table("lon,lat,z,u,v"))
    with pytest.raises(InputError, match="are no degrees") as refused:
        describe("a", [found], (1280, 720), None, None)
    assert "EPSG:25832" in refused.value.hint


def test_points_of_qgis_whose_pixels_count_downwards_are_read_so() -> None:
    rows = "\n".join(
        f"{x},{y},{u + 0.5},{v + 0.5},1" for (x, y, _), (u, v) in zip(GRID.tolist(), PIXELS.tolist(), strict=True)
    )
    _, [found] = read_named("a.points", f"mapX,mapY,sourceX,sourceY,enable\n{rows}\n")
    assert found.points is not None
    np.testing.assert_allclose(found.points.pixels, PIXELS, atol=1e-6)
    assert any("downwards" in note for note in found.notes)


@pytest.mark.parametrize(
    "properties",
    [{"pixel": [10, 20.5]}, {"pixel": "[ 10, 20.5 ]"}, {"px": 10, "py": "20.5"}, {"pixel_x": 10, "pixel_y": 20.5}],
)
def test_a_pixel_in_geojson_as_map_programs_keep_it(properties: dict[str, object]) -> None:
    point = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [11.5, 48.1]}, "properties": properties}
    _, [found] = read_named("a.geojson", json.dumps({"type": "FeatureCollection", "features": [point]}))
    assert found.points is not None
    assert found.points.pixels.tolist() == [[10.0, 20.5]]


@pytest.mark.parametrize("properties", [{"pixel": 5}, {"pixel": "a"}, {"pixel": {"u": 1}}, ["pixel"]])
def test_a_pixel_in_geojson_that_is_none_is_refused(properties: object) -> None:
    point = {"type": "Feature", "geometry": {"type": "Point", "coordinates": [11.5, 48.1]}, "properties": properties}
    with pytest.raises(InputError, match="pixel"):
        read_named("a.geojson", json.dumps({"type": "FeatureCollection", "features": [point]}))


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("x [ft],y [ft],z [ft],u,v", "the column x is in ft"),
        ("x [m],y [m],z (Feet),u,v", "the column z is in feet"),
        ("easting (us-ft),northing (us-ft),z,u,v", "easting is in us-ft"),
        ("#CRS: EPSG:25832\nx,y,z [cm],u,v", "z is in cm"),
    ],
)
def test_a_unit_that_is_no_metre_is_refused_by_name(header: str, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        read_named("p.csv", table(header.split("\n")[-1]).replace(header.split("\n")[-1], header))
    assert "Multiply it by 0." in caught.value.hint


@pytest.mark.parametrize("header", ["x (east),y (north),z [metres],u,v", "#CRS: EPSG:2263\nx [ft],y [ft],z,u,v"])
def test_what_stands_in_brackets_may_be_anything_else(header: str) -> None:
    last = header.split("\n")[-1]
    _, [camera] = read_named("p.csv", table(last).replace(last, header))
    assert camera.points is not None and len(camera.points.pixels) == len(PIXELS)


@pytest.mark.parametrize(
    ("value", "hint"),
    [
        ("11:34:13.2", "decimal degrees"),
        ("11 34 13.2 E", "decimal degrees"),
        ("11.570332E", "decimal degrees"),
        ("N48.137", "decimal degrees"),
        ("11°34'13.2\"", "decimal degrees"),
        ("about 11", "plain numbers"),
    ],
)
def test_degrees_that_are_written_otherwise_are_called_so(value: str, hint: str) -> None:
    with pytest.raises(InputError, match="line 2, lat") as error:
        read_named("points.tsv", f"lon\tlat\tu\tv\n1\t{value}\t3\t4\n")
    assert error.value.hint is not None and hint in error.value.hint


def test_columns_with_two_names_go_by_the_second() -> None:
    """As Metashape writes them."""
    _, [camera] = read_named("markers.csv", table("X/Easting,Y/Northing,Z/Altitude,u,v"))
    assert camera.points is not None
    np.testing.assert_allclose(camera.points.coordinates[:, :2], GRID[:, :2], atol=1e-6)
    np.testing.assert_allclose(camera.points.altitudes_m, GRID[:, 2], atol=1e-6)
    _, [camera] = read_named("markers.csv", table("X/Longitude,Y/Latitude,Z/Altitude,u,v"))
    assert camera.points is not None and camera.points.crs == "EPSG:4326"


def control_points(system: str, *, more: str = " north.jpg p1") -> str:
    rows = (
        f"{x:.4f}\t{y:.4f} {520 + z:.3f}  {u:.2f} {v:.2f}{more}" for (x, y, z), (u, v) in zip(GRID, PIXELS, strict=True)
    )
    return "\n".join([system, *rows, ""])


@pytest.mark.parametrize(
    ("system", "crs"),
    [
        ("EPSG:25832", "EPSG:25832"),
        ("WGS84 UTM 32N", "EPSG:32632"),
        ("WGS84 UTM 5S", "EPSG:32705"),
        ("+proj=utm +zone=32 +ellps=GRS80 +units=m +no_defs", "+proj=utm +zone=32 +ellps=GRS80 +units=m +no_defs"),
    ],
)
def test_control_points_of_opendronemap_are_read(system: str, crs: str) -> None:
    form, [camera] = read_named("gcp_list.txt", control_points(system))
    assert form == "OpenDroneMap gcp_list.txt" and camera.name == "north" and camera.points is not None
    assert camera.points.crs == crs
    np.testing.assert_allclose(camera.points.coordinates[:, :2], GRID[:, :2], atol=1e-3)
    assert np.isnan(camera.points.coordinates[:, 2]).all()
    np.testing.assert_allclose(camera.points.altitudes_m, 520 + GRID[:, 2], atol=1e-3)
    np.testing.assert_allclose(camera.points.pixels, PIXELS, atol=0.01)


def test_control_points_of_opendronemap_calibrate_a_camera() -> None:
    _, [camera] = read_named("gcp_list.txt", control_points("EPSG:25832", more=""))
    described = describe("north", [camera], (1280, 720))
    assert described.origin is not None and described.origin.altitude_m == pytest.approx(520.0, abs=3.0)
    assert described.camera.calibration.kind == "homography"


def test_pictures_of_several_cameras_in_one_list_are_told_apart() -> None:
    lines = control_points("EPSG:25832").splitlines()
    text = "\n".join([*lines, *(line.replace("north.jpg", "east.JPG") for line in lines[1:5]), "# end", ""])
    _, cameras = read_named("gcp_list.txt", text)
    assert [camera.name for camera in cameras] == ["north", "east"]


@pytest.mark.parametrize("behind", [r"D:\flights\my cam.jpg gcp.1", "my cam.JPG", "my cam.tiff 7"])
def test_names_of_pictures_in_lists_of_opendronemap_may_have_blanks(behind: str) -> None:
    lines = control_points("EPSG:25832").replace("north.jpg", behind)
    assert [camera.name for camera in read_named("gcp_list.txt", lines)[1]] == ["my cam"]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1 2 3 4", "line 2 does not begin"),
        ("1 2 3 nan 5 a.jpg", "not finite"),
        ("1 2 inf 4 5 a.jpg", "not finite"),
        ("", "no line has"),
    ],
)
def test_broken_control_points_of_opendronemap_are_refused(row: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_named("gcp_list.txt", f"EPSG:25832\n{row}\n")
