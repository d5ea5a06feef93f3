"""A network that is kept, and runs of it on new footage, through the whole service."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from wibam_core.client import JobView, WibamClient
from wibam_core.errors import Conflict, InputError, NotFound
from wibam_core.jobs.states import JobState
from wibam_core.models.weights import bundled
from wibam_core.site import Site
from wibam_core.synthetic.options import SimulationOptions
from wibam_core.synthetic.recorder import record_site
from wibam_core.video.decode import decode
from wibam_core.video.encode import VideoWriter

pytestmark = pytest.mark.end_to_end

SECONDS, FPS = 10.0, 5.0
JOINT_NS = 5_000_000_000
OPTIONS = {"sync": {"method": "none"}, "track": {"rate_hz": FPS}, "preflight": {"min_overlap_s": 1.0}}
BEGIN = "2026-07-01T08:00:00+02:00"
BEGIN_NS, SECOND_NS = 1_782_885_600_000_000_000, 1_000_000_000


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> tuple[Site, Path, Path]:
    """A site, and a camera's footage of it in two files, the second of which begins where the first ends."""
    folder = tmp_path_factory.mktemp("simulated")
    options = SimulationOptions(
        seed=5, cameras=2, seconds=SECONDS, fps=FPS, width_px=640, height_px=360, max_offset_s=0, max_drift_ppm=0
    )
    site = record_site(folder / "site", options)
    parts = [folder / "before.mp4", folder / "after.mp4"]
    frames = list(decode(next((folder / "site" / "recordings").glob("cam1.*"))))
    first_ns = frames[0][0]
    halves = ([f for f in frames if f[0] - first_ns < JOINT_NS], [f for f in frames if f[0] - first_ns >= JOINT_NS])
    for path, kept in zip(parts, halves, strict=True):
        height, width = kept[0][1].shape[:2]
        with VideoWriter(path, width, height, FPS) as writer:
            for time_ns, image in kept:
                writer.write(image, time_ns - kept[0][0])
    return site, parts[0], parts[1]


def ended(client: WibamClient, job: JobView) -> JobView:
    job = client.wait(job.id, timeout_s=600)
    job.raise_for_failure()
    assert job.state is JobState.SUCCEEDED
    return job


def test_a_network_is_kept_promoted_run_on_footage_and_its_tracks_go_on(
    client: WibamClient, footage: tuple[Site, Path, Path], tmp_path: Path
) -> None:
    site, before, after = footage
    site_id = client.create_site(site).id
    weights = bundled("mono_small.safetensors")

    model = client.keep_model(site_id, weights, "the bundled one")
    assert (model.version, model.state.value, model.job_id) == (1, "candidate", None)
    assert model.about.card.family == "wibam-small"
    assert client.change_model(model.id, state="promoted").state.value == "promoted"
    assert client.download_kept_model(model.id, tmp_path / "m.safetensors").read_bytes() == weights.read_bytes()
    assert client.download_kept_model(model.id, tmp_path / "m.onnx", "onnx").stat().st_size > 1_000_000

    first = client.upload_footage(site_id, "cam1", before, BEGIN)
    second = client.upload_footage(site_id, "cam1", after, "2026-07-01T06:00:05Z")
    undated = client.upload_footage(site_id, "cam2", after)
    assert [one.camera for one in client.footage(site_id)] == ["cam1", "cam1", "cam2"]
    with pytest.raises(InputError, match="1 of 2 files when they began"):
        client.create_run(model.id, [first, undated], OPTIONS)
    with pytest.raises(NotFound, match="no footage"):
        client.create_run(model.id, ["file_0000000000000000"], OPTIONS)

    one = ended(client, client.create_run(model.id, [first], OPTIONS))
    tracks = list(client.tracks(one.id))
    assert tracks
    assert min(state.time_ns for state in tracks) >= BEGIN_NS
    assert max(state.time_ns for state in tracks) < BEGIN_NS + 7 * SECOND_NS
    assert client.conflicts(one.id).conflicts is not None

    two = ended(client, client.create_run(model.id, [second], OPTIONS, continues=one.id))
    later = list(client.tracks(two.id))
    both = {state.track_id for state in tracks} & {state.track_id for state in later}
    assert both, "whoever is in view at the joint keeps their id"
    for track_id in both:
        end = [state for state in tracks if state.track_id == track_id][-1]
        start = next(state for state in later if state.track_id == track_id)
        assert start.road_user_class == end.road_user_class
        assert np.hypot(start.x_m - end.x_m, start.y_m - end.y_m) < 6.0
    assert {run.id for run in client.runs(model.id)} == {one.id, two.id}
    assert client.jobs(site_id) == []

    with pytest.raises(Conflict, match="no run of the same cameras"):
        client.create_run(model.id, [client.upload_footage(site_id, "cam2", before, BEGIN)], OPTIONS, continues=two.id)
    client.delete_model(model.id)
    with pytest.raises(NotFound):
        client.model(model.id)
    assert list(client.tracks(one.id)) == tracks, "what it found stays"
