from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from wibam_core.adapters.watched_folder import arrivals, began
from wibam_core.errors import InputError

NONE = timedelta()
NOW = 1_800_000_000.0


def put(folder: Path, name: str, age_s: float = 100.0, content: bytes = b"video") -> None:
    path = folder / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes(content)
    os.utime(path, (NOW - age_s, NOW - age_s))


@pytest.mark.parametrize(
    "name", ["2026-07-01_08-00-00.mp4", "cam 20260701T080000 a.mkv", "x_20260701080000.ts", "2026.07.01 08:00:00.mp4"]
)
def test_a_name_says_when_a_file_began(name: str) -> None:
    assert began(name, NONE) == datetime(2026, 7, 1, 8, tzinfo=UTC)
    assert began(name, timedelta(hours=2)) == datetime(2026, 7, 1, 6, tzinfo=UTC)


@pytest.mark.parametrize("offset", [NONE, timedelta(hours=2)])
def test_a_name_in_utc_says_so_and_may_have_thousandths(offset: timedelta) -> None:
    assert began("2026-07-01_08-00-00.250Z.mkv", offset) == datetime(2026, 7, 1, 8, 0, 0, 250_000, tzinfo=UTC)
    assert began("x_20260701080000250.mkv", offset) == datetime(2026, 7, 1, 8, 0, 0, 250_000, tzinfo=UTC) - offset
    assert began("2026-07-01_08-00-00.264", offset) == datetime(2026, 7, 1, 8, tzinfo=UTC) - offset
    assert began("2026-07-01T08:00:00Z.mkv", offset) == datetime(2026, 7, 1, 8, tzinfo=UTC)
    assert began("2026-07-01_08-00-00.3gp", offset) == datetime(2026, 7, 1, 8, tzinfo=UTC) - offset
    assert began("2026-07-01_08-00-00Zebra.mkv", offset) == datetime(2026, 7, 1, 8, tzinfo=UTC) - offset


@pytest.mark.parametrize("name", ["north.mp4", "2026-13-01_08-00-00.mp4", "120260701080000.mp4"])
def test_a_name_that_says_no_time_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="does not say when the file began"):
        began(name, NONE)


def test_complete_files_come_by_time_once(tmp_path: Path) -> None:
    put(tmp_path, "south/2026-07-01_08-05-00.mp4")
    put(tmp_path, "north/2026-07-01_08-10-00.mp4")
    put(tmp_path, "north/2026-07-01_08-00-00.mp4")
    put(tmp_path, "north/2026-07-01_08-20-00.mp4", age_s=3.0)  # it still grows
    put(tmp_path, "north/2026-07-01_08-30-00.mp4", content=b"")
    put(tmp_path, "north/wibam-recorded/2026-07-01_08-30-00.000Z.mkv", age_s=0.0)  # complete once it has its name
    put(tmp_path, "north/wibam-recorded/.2026-07-01_08-40-00.000Z.mkv", age_s=0.0)
    put(tmp_path, "north/2026-07-01_08-35-00.000Z.mkv", age_s=0.0)  # another recorder's, which still grows
    put(tmp_path, "north/thumbnail.jpg")
    put(tmp_path, "north/.2026-07-01_08-40-00.mp4")
    found = arrivals(tmp_path, {"north/2026-07-01_08-10-00.mp4"}, 30.0, NONE, NOW, pytest.fail)
    assert [(one.camera, one.path.name) for one in found] == [
        ("north", "2026-07-01_08-00-00.mp4"),
        ("south", "2026-07-01_08-05-00.mp4"),
        ("north", "2026-07-01_08-30-00.000Z.mkv"),
    ]


def test_files_that_are_gone_or_misnamed_hold_no_other_up(tmp_path: Path) -> None:
    put(tmp_path, "north/2026-07-01_08-00-00.mp4")
    (tmp_path / "north" / "2026-07-01_08-10-00.mp4").symlink_to(tmp_path / "nothing.mp4")
    put(tmp_path, "north/x.mp4")
    unclear: list[InputError] = []
    (found,) = arrivals(tmp_path, set(), 30.0, NONE, NOW, unclear.append)
    assert found.path.name == "2026-07-01_08-00-00.mp4"
    assert ["'x.mp4'" in error.message for error in unclear] == [True]
