"""What is known of recordings before anything is learned, as a page: doubts, clocks, views."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.browser.conftest import Visit
from tests.builders import corner_rig, site_of
from tests.clips import write as write_of_clips
from tests.finished import VIDEO, publish
from tests.service import LiveApi
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.clocks import ClockMap
from wibam_core.documents.calibration import CalibrationResiduals, Overlap, PairOverlap
from wibam_core.documents.recordings import Probe
from wibam_core.formats.clocks import Clocks

CAMERAS = ("cam1", "cam2")
#: Of this test alone: what `calibrate` makes of a rig is the same for all jobs with that rig.
RIG = corner_rig(2, radius_m=23.5)
#: The second camera began so much later, and its clock began at 0 then.
LATER_S = 7.5


def _write(stage: str, folder: Path) -> None:
    writer = ArtifactWriter(stage, folder, made_by(stage))
    if stage == "preflight":
        odd = VIDEO.model_copy(update={"missing_frames": 24, "variable_rate": True})
        writer.write(catalogue.PROBE, Probe(cameras={"cam1": VIDEO, "cam2": odd}))
    if stage == "calibrate":
        writer.write(catalogue.CALIBRATED_RIG, RIG)
        pair = PairOverlap(cameras=list(CAMERAS), area_m2=123.4, share=0.25)
        overlap = Overlap(
            within_m=60, area_m2={"cam1": 900, "cam2": 500}, pairs=[pair], seen_by_m2={"1": 1300, "2": 123}
        )
        writer.write(catalogue.RESIDUALS, CalibrationResiduals(overlap=overlap, cameras={}))
    if stage in (catalogue.RIG.stage, catalogue.FRAMES.stage):
        write_of_clips(stage, folder)
    if stage == "sync":
        clocks = Clocks({"cam1": ClockMap(), "cam2": ClockMap(offset_ns=round(LATER_S * 1e9), drift=1e-4)})
        writer.write(catalogue.CLOCKS, clocks)


def test_doubts_clocks_and_views_are_said(signed_in: Visit, api: LiveApi) -> None:
    site = str(api.http.post("/v1/sites", json=site_of(RIG).model_dump(mode="json")).json()["id"])
    for camera in CAMERAS:
        api.upload(site, b"preflight" + camera.encode(), camera)
    job = str(api.http.post(f"/v1/sites/{site}/jobs", json={"name": "before"}).json()["id"])
    page = signed_in.open(f"/jobs/{job}/preflight")
    page.get_by_text("Not known yet: ").wait_for()
    assert page.locator("#known").is_hidden()
    publish(api, job, _write)
    page.reload()
    page.get_by_text("The clock of cam3 is ambiguous").wait_for()
    page.get_by_text("Compare a moving vehicle in two cameras").wait_for()
    page.get_by_text("All cameras record from 7.5 s to 10.0 s: 2.5 s, the shaded stretch.").wait_for()
    page.get_by_text("All cameras share 2.5 s of up to 10.0 s").wait_for()
    row = page.get_by_role("row", name="cam2", exact=False).first
    assert "24 frames are missing at its end; its rate varies" in row.inner_text()
    pair = page.get_by_role("row", name="cam1 and cam2").inner_text()
    assert "123" in pair and "25 %" in pair
    signed_in.picture("preflight")


def test_places_are_shaded_by_how_many_cameras_see_them(signed_in: Visit) -> None:
    """Two cameras on opposite sides look at the middle: both see it, behind each only the other sees."""
    rig = corner_rig(2)
    cameras = [
        {
            "id": name,
            "width_px": camera.width_px,
            "height_px": camera.height_px,
            "K": camera.K.tolist(),
            "dist": [],
            "lens": "pinhole",
            "xi": 0,
            "distortion_limit": None,
            "limit_rad": None,
            "T_world_cam": camera.T_world_cam.matrix[:3].tolist(),
        }
        for name, camera in rig.items()
    ]
    script = """async (given) => {
      const { Coverage } = await import("/static/js/coverage.js");
      const { Camera } = await import("/static/js/projection.js");
      const found = new Coverage(given.map((one) => new Camera(one)));
      return { cells: found.cells, cell: found.cell };
    }"""
    signed_in.page.get_by_role("heading", name="Jobs").wait_for()
    found = signed_in.page.evaluate(script, cameras)
    cells = np.array(found["cells"])
    middle = cells[:, :2] + found["cell"] / 2
    in_sight = []
    for camera in rig.values():
        uv, depth = camera.project(np.column_stack([middle, np.zeros(len(middle))]))
        near = np.linalg.norm(middle - camera.centre_m[:2], axis=1) < 60
        in_sight.append(camera.contains(uv) & (depth > 0) & near)
    expected = np.sum(in_sight, axis=0)
    assert (expected == cells[:, 2]).mean() > 0.97, "but for cells at the edge of a view"
    assert {1, 2} <= set(cells[:, 2])
