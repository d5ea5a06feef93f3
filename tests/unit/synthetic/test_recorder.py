"""A recorded site can be read back, and its truth agrees with its pixels and clocks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from wibam_core.formats.clocks import read_clocks
from wibam_core.formats.labels import read_labels
from wibam_core.formats.rig import read_rig
from wibam_core.geometry.box3d import corners
from wibam_core.site import MatrixCalibration, Site
from wibam_core.synthetic.clocks import CameraClock
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site
from wibam_core.video.decode import decode

OPTIONS = SimulationOptions(
    seed=3, cameras=2, seconds=12.0, fps=6.25, width_px=480, height_px=270, cycle_s=14.0, drop_rate=0.05
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("site")
    record_site(path, OPTIONS)
    return path


def test_site_file_describes_the_rig(folder: Path) -> None:
    site, rig = Site.load(folder / "site.json"), read_rig(folder / "truth" / "rig.json")
    assert site.camera_ids == tuple(rig)
    for camera in site.cameras:
        assert isinstance(camera.calibration, MatrixCalibration)
        assert np.allclose(camera.calibration.K, rig[camera.id].K)
        rvec, tvec = rig[camera.id].T_cam_world.to_rvec_tvec()
        assert np.allclose(camera.calibration.rvec, rvec)
        assert np.allclose(camera.calibration.tvec, tvec)
        assert camera.signals


def test_recordings_keep_their_own_clocks_and_lose_frames(folder: Path) -> None:
    table = pq.read_table(folder / "truth" / "boxes2d.parquet")
    for camera in ("cam1", "cam2"):
        times = np.array([t for t, _ in decode(folder / "recordings" / f"{camera}.mp4")])
        full = OPTIONS.seconds * OPTIONS.fps
        assert 0.8 * full < len(times) < full
        steps = np.diff(times) / (1e9 / OPTIONS.fps)
        assert steps == pytest.approx(np.rint(steps), abs=1e-3)
        assert steps.max() >= 1.99
        of_camera = np.array([c == camera for c in table["camera_id"].to_pylist()])
        known = np.unique(table["time_ns"].to_numpy()[of_camera])
        assert np.abs(known[:, None] - times).min(axis=1).max() < 10_000  # a tick of the file is 11 µs


def test_signal_changes_match_the_pixels(folder: Path) -> None:
    site = Site.load(folder / "site.json")
    changes = json.loads((folder / "truth" / "changes.json").read_text())
    checked = 0
    for camera in site.cameras:
        frames = list(decode(folder / "recordings" / f"{camera.id}.mp4"))
        times = np.array([t for t, _ in frames])
        for signal in camera.signals:
            x, y, w, h = (round(v) for v in signal.region)
            for change in changes:
                if (change["camera_id"], change["signal_id"]) != (camera.id, signal.id):
                    continue
                k = int(np.searchsorted(times, change["time_ns"]))
                for frame, state in ((k - 1, change["before"]), (k, change["after"])):
                    if 0 <= frame < len(frames):
                        assert _colour(frames[frame][1][y : y + h, x : x + w]) == state
                        checked += 1
    assert checked >= 8


def _colour(patch: np.ndarray) -> str:
    """What the most saturated pixels of a signal head show."""
    pixels = patch.reshape(-1, 3).astype(float)
    b, g, r = pixels[np.argsort(np.ptp(pixels, axis=1))[-5:]].mean(axis=0)
    if g > r:
        return "green"
    return "amber" if g - b > 60 else "red"


def test_labels_project_onto_the_visible_boxes(folder: Path) -> None:
    """World boxes, clocks and cameras fit together: a label's cuboid encloses what that camera saw at that time."""
    rig, clocks = read_rig(folder / "truth" / "rig.json"), read_clocks(folder / "truth" / "clocks.json")
    table = pq.read_table(folder / "truth" / "boxes2d.parquet").to_pydict()
    checked = 0
    for label in read_labels(folder / "labels.parquet")[::10]:
        for camera_id, camera in rig.items():
            local_ns = int(clocks[camera_id].to_local_ns(label.vehicles.time_ns))
            for i, box in enumerate(label.vehicles.boxes):
                if label.visibility[camera_id][i] < 0.5:
                    continue
                rows = [
                    r
                    for r, (c, t, v) in enumerate(
                        zip(table["camera_id"], table["time_ns"], table["vehicle_id"], strict=True)
                    )
                    if c == camera_id and v == label.vehicles.ids[i] and abs(t - local_ns) < 30_000_000
                ]
                uv, depth = camera.project(corners(box))
                if not rows or (depth < 1).any():
                    continue
                r = rows[0]
                slack = 6 + 0.1 * (table["amodal_x1"][r] - table["amodal_x0"][r])  # up to 30 ms of motion
                assert uv[:, 0].min() - slack <= table["visible_x0"][r]
                assert uv[:, 0].max() + slack >= table["visible_x1"][r]
                assert uv[:, 1].max() + slack >= table["visible_y1"][r]
                checked += 1
    assert checked >= 5


def test_label_instants_are_multiples_of_the_period(folder: Path) -> None:
    labels = read_labels(folder / "labels.parquet")
    assert len(labels) > 100
    assert all(label.vehicles.time_ns % 80_000_000 == 0 for label in labels)
    assert (np.diff([label.vehicles.time_ns for label in labels]) == 80_000_000).all()


def test_clock_maps_agree_with_the_clocks() -> None:
    reference, other = CameraClock(1.25, 40e-6, 0), CameraClock(0.5, -30e-6, 7)
    clock = other.map_to(reference)
    for true_s in (0.0, 10.0, 600.0):
        expected = reference.local_ns(true_s)
        assert abs(int(clock.to_reference_ns(other.local_ns(true_s))) - expected) <= 3
    assert other.true_s(other.local_ns(12.5)) == pytest.approx(12.5, abs=1e-9)


@pytest.mark.slow
def test_several_processes_write_the_same_files(folder: Path, tmp_path: Path) -> None:
    record_site(tmp_path, OPTIONS.model_copy(update={"workers": 2}))
    names = sorted(p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file())
    assert [name for name in names if (folder / name).read_bytes() != (tmp_path / name).read_bytes()] == []
