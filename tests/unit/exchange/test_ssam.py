"""SSAM: a reader written from the published file format finds what was given."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.exchange_content import PERIOD_NS, content
from wibam_core.errors import InputError
from wibam_core.exchange.base import Content
from wibam_core.exchange.ssam import Ssam


def read_trj(path: Path) -> tuple[dict[str, Any], list[tuple[float, list[dict[str, float]]]]]:
    """Header and time steps, byte for byte by the Open Source SSAM File Format v3.0."""
    data = path.read_bytes()
    assert data[0] == 0, "a FORMAT record comes first"
    order = {b"L": "<", b"B": ">"}[data[1:2]]
    version, z_option = struct.unpack_from(order + "fB", data, 2)
    at = 7
    assert data[at] == 1, "a DIMENSIONS record comes second"
    units, scale, x0, y0, x1, y1 = struct.unpack_from(order + "Bfiiii", data, at + 1)
    header = {"version": version, "z": z_option, "units": units, "scale": scale, "bounds": (x0, y0, x1, y1)}
    at += 22
    steps: list[tuple[float, list[dict[str, float]]]] = []
    while at < len(data):
        if data[at] == 2:
            steps.append((struct.unpack_from(order + "f", data, at + 1)[0], []))
            at += 5
        else:
            assert data[at] == 3, f"an unknown record at byte {at}"
            names = (
                *("vehicle", "link", "lane", "front_x", "front_y", "rear_x", "rear_y"),
                *("length", "width", "speed", "acceleration", "front_z", "rear_z"),
            )
            values = struct.unpack_from(order + "iiB10f", data, at + 1)
            steps[-1][1].append(dict(zip(names, values, strict=True)))
            at += 50
    return header, steps


def test_header_says_metres_and_bounds_around_every_vehicle(tmp_path: Path) -> None:
    (path,) = Ssam().write(content(), tmp_path)
    header, _ = read_trj(path)
    assert (header["version"], header["units"], header["scale"]) == (3.0, 1, 1.0)
    x0, y0, x1, y1 = header["bounds"]
    centres = np.concatenate([track.boxes[:, :2] for track in content().tracks or ()])
    assert (centres > [x0, y0]).all() and (centres < [x1, y1]).all()


def test_every_instant_lists_the_road_users_that_are_there(tmp_path: Path) -> None:
    tracks = list(content().tracks or ())
    tracks[2] = replace(tracks[2], **{name: getattr(tracks[2], name)[1:3] for name in _PER_STATE})
    (path,) = Ssam().write(Content(tracks=tracks), tmp_path)
    _, steps = read_trj(path)
    np.testing.assert_allclose([time for time, _ in steps], np.arange(5) * PERIOD_NS * 1e-9, rtol=1e-6)
    assert [[row["vehicle"] for row in rows] for _, rows in steps] == [
        [10, 11],
        [10, 11, 12],
        [10, 11, 12],
        [10, 11],
        [10, 11],
    ]


_PER_STATE = ("times_ns", "boxes", "sd", "velocities_mps", "yaw_rates_radps")


def test_convention_front_and_rear_are_the_bumpers_middles(tmp_path: Path) -> None:
    (path,) = Ssam().write(content(), tmp_path)
    _, steps = read_trj(path)
    car, van, truck = steps[0][1]
    # the car drives to the east, 4.4 m long, with its middle at (-6, -2)
    assert (car["front_x"], car["front_y"]) == pytest.approx((-3.8, -2.0))
    assert (car["rear_x"], car["rear_y"]) == pytest.approx((-8.2, -2.0))
    assert (car["length"], car["width"], car["speed"]) == pytest.approx((4.4, 1.8, 10.0))
    # the van to the north-west
    assert van["front_x"] < van["rear_x"] and van["front_y"] > van["rear_y"]
    assert np.hypot(van["front_x"] - van["rear_x"], van["front_y"] - van["rear_y"]) == pytest.approx(5.3, rel=1e-6)
    assert (truck["speed"], truck["acceleration"], truck["front_z"]) == pytest.approx((0.0, 0.0, 0.0))


def test_braking_is_a_negative_acceleration_whatever_the_heading(tmp_path: Path) -> None:
    van = (content().tracks or ())[1]
    slower = van.velocities_mps * np.linspace(1, 0.8, 5)[:, None]
    (path,) = Ssam().write(Content(tracks=[replace(van, velocities_mps=slower)]), tmp_path)
    _, steps = read_trj(path)
    expected = -0.05 * np.hypot(6.25, 6.25) / (PERIOD_NS * 1e-9)
    assert [row["acceleration"] for _, (row,) in steps] == pytest.approx([expected] * 5, rel=1e-5)


def test_no_tracks_are_a_header_alone(tmp_path: Path) -> None:
    (path,) = Ssam().write(Content(tracks=[]), tmp_path)
    assert read_trj(path)[1] == []


def test_content_without_tracks_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without tracks"):
        Ssam().write(Content(), tmp_path)
