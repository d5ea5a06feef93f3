"""A worker renders clips in a confined process: once, to the end, or with a reason."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from tests.clips import clip_job
from tests.service import LiveApi, live_api, settings_for
from wibam_core.adapters.clip_store import ClipStore
from wibam_core.adapters.settings import StageLimits
from wibam_core.artifacts import catalogue
from wibam_core.documents.clips import ClipSpec
from wibam_core.errors import NotFound
from wibam_core.jobs.clips import Clip, ClipState
from wibam_core.jobs.leases import LeasePolicy
from worker.clips import ClipRunner
from worker.workplace import Workplace

SPEC = ClipSpec(start_ns=10**9, end_ns=2 * 10**9, width_px=640)
LIMITS = StageLimits(memory_bytes=4_000_000_000, seconds=600.0)
POLICY = LeasePolicy()


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    with live_api(settings_for(tmp_path_factory.mktemp("service"))) as running:
        yield running


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return clip_job(api)


def asked(api: LiveApi, job: str, spec: ClipSpec = SPEC) -> Clip:
    stage = api.services.jobs.job(job).stage(catalogue.TRACKS.stage)
    assert stage is not None
    return api.services.clips.create(job, stage.hash, spec)


def runner(api: LiveApi, limits: StageLimits = LIMITS, **values: object) -> ClipRunner:
    services = api.services
    at = Workplace(services.jobs, services.folder, limits, POLICY, "tests", **values)  # type: ignore[arg-type]
    return ClipRunner(at, services.clips)


def left_behind(api: LiveApi) -> list[str]:
    return [path.name for path in (api.services.folder.root / "clips").iterdir() if path.name.startswith(".")]


def test_a_clip_is_rendered_once(api: LiveApi, job: str) -> None:
    clip = asked(api, job)
    assert runner(api).run(clip.id)
    done = api.services.clips.clip(job, clip.id)
    assert (done.state, done.fraction, done.error) == (ClipState.SUCCEEDED, 1.0, None)
    assert done.facts is not None and (done.facts.frames, done.facts.width_px) == (10, 640)
    path = api.services.folder.clip(clip.id)
    assert path.stat().st_size == done.size_bytes
    written = path.stat().st_mtime_ns
    assert not runner(api).run(clip.id), "a second delivery does nothing"
    assert path.stat().st_mtime_ns == written
    assert left_behind(api) == []


def test_one_that_shows_nothing_fails_with_a_reason(api: LiveApi, job: str) -> None:
    clip = asked(api, job, SPEC.model_copy(update={"start_ns": 60 * 10**9, "end_ns": 61 * 10**9}))
    runner(api).run(clip.id)
    failed = api.services.clips.clip(job, clip.id)
    assert failed.state is ClipState.FAILED
    assert failed.error is not None and "nothing was tracked" in failed.error["message"]
    assert not api.services.folder.clip(clip.id).exists()


def test_one_of_tracks_that_are_no_more_fails(api: LiveApi, job: str) -> None:
    clip = api.services.clips.create(job, "0" * 64, SPEC)
    runner(api).run(clip.id)
    error = api.services.clips.clip(job, clip.id).error
    assert error is not None and "other tracks" in error["message"]


@pytest.mark.parametrize(
    ("limits", "code"),
    [(replace(LIMITS, memory_bytes=1000), "stage_out_of_memory"), (replace(LIMITS, seconds=1e-9), "stage_timed_out")],
)
def test_one_that_takes_too_much_is_stopped(api: LiveApi, job: str, limits: StageLimits, code: str) -> None:
    clip = asked(api, job)
    runner(api, limits).run(clip.id)
    error = api.services.clips.clip(job, clip.id).error
    assert error is not None and error["code"] == code
    assert left_behind(api) == []


def test_one_that_is_deleted_meanwhile_is_dropped(api: LiveApi, job: str) -> None:
    clip = asked(api, job)

    def delete_it() -> bool:
        try:
            api.services.clips.delete(job, clip.id)
        except NotFound:
            return False
        return False

    assert not runner(api, stopping=delete_it).run(clip.id)
    assert not api.services.folder.clip(clip.id).exists()
    assert left_behind(api) == []


def test_a_worker_that_stops_gives_it_back(api: LiveApi, job: str) -> None:
    clip = asked(api, job)
    runner(api, stopping=lambda: True).run(clip.id)
    assert api.services.clips.clip(job, clip.id).state is ClipState.QUEUED
    assert runner(api).run(clip.id)
    assert api.services.clips.clip(job, clip.id).state is ClipState.SUCCEEDED


def test_lost_workers_and_lost_messages_are_found(api: LiveApi, job: str) -> None:
    now = 1e9
    clips = ClipStore(api.services.database, POLICY, lambda: now)
    clip = asked(api, job)
    for attempt in range(1, POLICY.max_attempts + 1):
        claim = clips.claim(clip.id, "a worker that dies")
        assert claim is not None and claim.attempt == attempt
        assert clip.id not in clips.reap()
        now += POLICY.duration_s + 1.0
        sent = clips.reap()
        assert (clip.id in sent) == (attempt < POLICY.max_attempts)
    failed = clips.clip(job, clip.id)
    assert failed.state is ClipState.FAILED and failed.error is not None
    assert "lost its worker 3 times" in failed.error["message"]
    forgotten = ClipStore(api.services.database, POLICY, lambda: now).create(job, "0" * 64, SPEC)
    assert clips.reap() == []
    now += POLICY.resend_s
    assert clips.reap() == [forgotten.id]
    assert clips.reap() == []
    assert clips.claim(forgotten.id, "a worker that is known to be gone") is not None
    assert clips.reap(gone=["another"]) == []
    assert clips.reap(gone=["a worker that is known to be gone"]) == [forgotten.id]


def test_a_rendering_that_lasts_long_is_not_tidied_away(api: LiveApi, job: str) -> None:
    hours_ago = time.time() - 7200
    with api.services.folder.clip_workspace("clip_" + "1" * 16) as home:
        (Path(home) / "clip.mp4").write_bytes(b"so far")
        os.utime(home, (hours_ago, hours_ago))
        api.services.folder.tidy_clips(api.services.clips.ids)
        assert (Path(home) / "clip.mp4").exists()
        os.utime(Path(home) / "clip.mp4", (hours_ago, hours_ago))
        api.services.folder.tidy_clips(api.services.clips.ids)
        assert not Path(home).exists()


def test_files_that_nobody_knows_are_tidied(api: LiveApi, job: str, tmp_path: Path) -> None:
    folder = api.services.folder
    known = asked(api, job)
    for path in (folder.clip(known.id), folder.clip("clip_" + "0" * 16)):
        path.write_bytes(b"mp4")
    (folder.root / "clips" / ".clip_killed").mkdir()
    folder.tidy_clips(api.services.clips.ids)
    assert folder.clip("clip_" + "0" * 16).exists(), "it may be new"
    folder.tidy_clips(api.services.clips.ids, older_than_s=-1.0)
    assert [path.name for path in (folder.root / "clips").iterdir() if "0" * 16 in path.name] == []
    assert folder.clip(known.id).exists()
    assert left_behind(api) == []
