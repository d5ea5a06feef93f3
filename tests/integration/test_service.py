"""Jobs through the whole service: HTTP, database, Redis, Celery worker, stage processes."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from tests.builders import corner_rig, site_of
from tests.recordings import write_recording
from tests.service import wait_until
from wibam_core.cli.embedded import EmbeddedService
from wibam_core.client import JobView, WibamClient
from wibam_core.errors import Conflict, MissingCamera, Unauthorised, UnknownOption
from wibam_core.jobs.states import JobState, StageState

SITE = site_of(corner_rig(2))
OPTIONS = {"preflight": {"min_overlap_s": 1.0}}  # the cameras have no signals, so that jobs end at sync: soon

#: How long a job may take on a busy machine; it takes seconds.
PATIENCE_S = 600.0


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Noise: it can be decoded, and nothing is in it."""
    return write_recording(tmp_path_factory.mktemp("video") / "noise.mp4", width_px=640, height_px=360, seconds=3.0)


def send(client: WibamClient, recording: Path, cameras: tuple[str, ...] = ("cam1", "cam2")) -> str:
    site = client.create_site(SITE)
    for camera in cameras:
        client.upload_recording(site.id, camera, recording)
    return site.id


def stage(job: JobView, name: str) -> StageState:
    return next(item.state for item in job.stages if item.name == name)


def running() -> dict[int, tuple[int, str]]:
    """Parent and command line of every process that has not ended: anybody may read these."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, parent = (folder / "stat").read_text().rpartition(")")[2].split()[:2]
            command = os.fsdecode((folder / "cmdline").read_bytes()).replace("\0", " ")
        except OSError:
            continue  # it has just ended
        if state != "Z":
            found[int(folder.name)] = (int(parent), command)
    return found


def descendants(ancestor: int) -> list[int]:
    """Processes that this one started, or that those did."""
    parents = {pid: parent for pid, (parent, _) in running().items()}
    found: list[int] = []
    generation = [ancestor]
    while generation:
        generation = [pid for pid, parent in parents.items() if parent in generation]
        found += generation
    return found


def parts_of_the_service(marker: str) -> list[int]:
    """Processes of this test's service with ``marker`` in their command line."""
    everything = running()
    return [pid for pid in descendants(os.getpid()) if pid in everything and marker in everything[pid][1]]


def stages_of(service_data: Path, min_overlap_s: float) -> list[int]:
    """Processes of stages of the job that has this option."""
    found = []
    for pid, (_, command) in running().items():
        if "stages.execute" not in command or str(service_data) not in command:
            continue
        try:
            request = Path(os.fsdecode(Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")[-2]))
            if json.loads(request.read_bytes())["config"]["preflight"]["min_overlap_s"] == min_overlap_s:
                found.append(pid)
        except OSError:
            continue  # it has just ended
    return found


class TestJobs:
    def test_a_job_runs_up_to_the_stage_that_cannot_go_on(self, client: WibamClient, recording: Path) -> None:
        site = send(client, recording)
        updates: list[JobView] = []
        job = client.wait(client.create_job(site, OPTIONS).id, updates.append, timeout_s=PATIENCE_S, interval_s=0.1)
        assert job.state is JobState.FAILED
        assert job.error is not None
        assert job.error.code == "unknown_clock"
        assert job.error.hint
        assert job.error.details["stage"] == "sync"
        assert stage(job, "preflight") is StageState.SUCCEEDED
        assert stage(job, "finetune") is StageState.PENDING
        assert {JobState.RUNNING, JobState.FAILED} <= {update.state for update in updates}
        assert "[preflight] done" in client.log(job.id)[0]
        assert {file.camera for file in client.files(site)} == {"cam1", "cam2"}
        would = {planned.name: planned.would for planned in client.plan(site, OPTIONS)}
        assert (would["preflight"], would["sync"]) == ("reuse", "run")
        again = client.wait(client.create_job(site, OPTIONS).id, timeout_s=PATIENCE_S)
        assert stage(again, "preflight") is StageState.REUSED

    def test_frames_and_detections_are_made(self, client: WibamClient, recording: Path) -> None:
        job = client.create_job(send(client, recording), {**OPTIONS, "sync": {"method": "none"}})
        job = client.wait(job.id, timeout_s=PATIENCE_S)
        assert stage(job, "detect") is StageState.SUCCEEDED or stage(job, "frames") is StageState.SUCCEEDED
        assert job.error is not None
        assert job.error.code in ("no_vehicles", "no_multiview_vehicles")

    def test_a_recording_that_is_none_fails_its_job_alone(
        self, client: WibamClient, recording: Path, tmp_path: Path
    ) -> None:
        text = tmp_path / "notes.mp4"
        text.write_text("not a video at all")
        site = send(client, recording, cameras=("cam1",))
        client.upload_recording(site, "cam2", text)
        job = client.wait(client.create_job(site, OPTIONS).id, timeout_s=PATIENCE_S)
        assert job.error is not None
        assert job.error.code == "unreadable_video"
        assert "cam2" in job.error.message
        client.upload_recording(site, "cam2", recording)
        again = client.create_job(site, OPTIONS)
        assert not again.state.is_terminal
        assert stage(client.wait(again.id, timeout_s=PATIENCE_S), "preflight").has_outputs

    def test_a_running_job_can_be_cancelled_and_restarted(self, client: WibamClient, recording: Path) -> None:
        options = {"preflight": {"min_overlap_s": 1.1}}
        job = client.create_job(send(client, recording), options)
        wait_until(lambda: client.job(job.id).state is JobState.RUNNING)
        client.cancel(job.id)
        cancelled = client.wait(job.id, timeout_s=PATIENCE_S)
        assert cancelled.state is JobState.CANCELLED
        assert StageState.RUNNING not in {item.state for item in cancelled.stages}
        client.restart(job.id)
        ended = client.wait(job.id, timeout_s=PATIENCE_S)
        assert stage(ended, "preflight").has_outputs
        client.delete_job(job.id)
        assert job.id not in {found.id for found in client.jobs()}

    def test_the_oldest_job_ends_before_the_newest_begins(self, client: WibamClient, recording: Path) -> None:
        site = send(client, recording)
        options = [{"preflight": {"min_overlap_s": 1.0 + number / 100}} for number in range(4)]  # nothing is reused
        jobs = [client.create_job(site, option).id for option in options]
        wait_until(lambda: stage(client.job(jobs[-1]), "preflight") is not StageState.QUEUED, PATIENCE_S)
        assert client.job(jobs[0]).state.is_terminal
        wait_until(lambda: client.job(jobs[-1]).state.is_terminal, PATIENCE_S)

    def test_what_cannot_work_is_refused_at_once(self, client: WibamClient, recording: Path) -> None:
        site = send(client, recording, cameras=("cam1",))
        with pytest.raises(MissingCamera) as missing:
            client.create_job(site)
        assert missing.value.details == {"cameras": ["cam2"]}
        with pytest.raises(UnknownOption):
            client.create_job(site, {"finetune": {"speed": "fast"}})


class TestDeaths:
    def test_a_killed_stage_is_a_crash_with_its_log(
        self, service: EmbeddedService, client: WibamClient, recording: Path
    ) -> None:
        job = client.create_job(send(client, recording), {"preflight": {"min_overlap_s": 1.2}})

        def ended_by_kills() -> bool:
            for pid in stages_of(service.data_dir, 1.2):
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    os.kill(pid, signal.SIGKILL)
            return client.job(job.id).state.is_terminal

        wait_until(ended_by_kills, PATIENCE_S)
        failed = client.job(job.id)
        assert failed.error is not None
        assert failed.error.code == "stage_crashed"

    def test_a_killed_worker_is_replaced_and_its_stage_taken_up(
        self, service: EmbeddedService, client: WibamClient, recording: Path
    ) -> None:
        job = client.create_job(send(client, recording), {"preflight": {"min_overlap_s": 1.3}})
        wait_until(lambda: client.job(job.id).state is JobState.RUNNING)
        workers = parts_of_the_service("worker.app")
        assert workers
        for pid in workers:
            os.kill(pid, signal.SIGKILL)
        wait_until(lambda: not stages_of(service.data_dir, 1.3))
        ended = client.wait(job.id, timeout_s=PATIENCE_S)
        assert stage(ended, "preflight") is StageState.SUCCEEDED
        assert "attempt 2" in client.log(job.id)[0]

    def test_a_killed_redis_is_replaced_and_loses_no_job(
        self, service: EmbeddedService, client: WibamClient, recording: Path
    ) -> None:
        site = send(client, recording)
        brokers = parts_of_the_service("redis.sock")
        assert brokers
        for pid in brokers:
            os.kill(pid, signal.SIGKILL)
        job = client.create_job(site, {"preflight": {"min_overlap_s": 1.4}})
        ended = client.wait(job.id, timeout_s=PATIENCE_S)
        assert stage(ended, "preflight") is StageState.SUCCEEDED


class TestService:
    def test_the_token_is_private_and_needed(self, service: EmbeddedService) -> None:
        path = service.data_dir / "token"
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert path.read_text().strip() == service.token
        assert httpx.get(f"{service.url}/readyz", timeout=PATIENCE_S).status_code == 200
        with pytest.raises(Unauthorised), WibamClient(service.url, "wrong") as client:
            client.sites()

    def test_a_folder_has_one_service(self, service: EmbeddedService) -> None:
        with pytest.raises(Conflict, match="another service"), EmbeddedService(service.data_dir):
            pass

    def test_a_taken_port_is_said(self, service: EmbeddedService, tmp_path: Path) -> None:
        port = int(service.url.rpartition(":")[2])
        with pytest.raises(Conflict, match="cannot listen"), EmbeddedService(tmp_path / "d", port=port):
            pass

    def test_a_long_and_odd_path_will_do(self, tmp_path: Path) -> None:
        with EmbeddedService(tmp_path / ("ä b" * 30) / "data") as service:
            assert httpx.get(f"{service.url}/readyz", timeout=PATIENCE_S).status_code == 200

    def test_after_kill_nothing_is_left_and_the_folder_works_again(self, tmp_path: Path) -> None:
        data = tmp_path / "data"
        code = f"""
import sys, time
from pathlib import Path
from wibam_core.cli.embedded import EmbeddedService
with EmbeddedService(Path({str(data)!r})) as service:
    print(service.url, service.token, flush=True)
    time.sleep(600)
"""
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            url, token = process.stdout.readline().split()
            with WibamClient(url, token) as client:
                site = client.create_site(SITE).id
            parts = descendants(process.pid)
            assert len(parts) >= 3
            process.kill()
        wait_until(lambda: not set(parts) & running().keys())
        with EmbeddedService(data) as service, WibamClient(service.url, service.token) as client:
            assert service.token == token
            assert [found.id for found in client.sites()] == [site]
