from __future__ import annotations

import dataclasses

import pytest

from wibam_core.jobs.estimate import job_fraction, remaining_s, stage_remaining_s
from wibam_core.jobs.leases import LeasePolicy
from wibam_core.jobs.records import Job, Purpose, StageRun, StoredFile, Upload
from wibam_core.jobs.states import JobState, StageState
from wibam_core.site import Site

SITE = Site.model_validate(
    {
        "name": "s",
        "cameras": [
            {
                "id": "north",
                "width_px": 64,
                "height_px": 48,
                "calibration": {"kind": "homography", "correspondences": []},
            }
        ],
    }
)


def job(*stages: StageRun, state: JobState = JobState.RUNNING) -> Job:
    return Job("job_1", "site_1", SITE, {}, (), stages, state, created_at=0.0)


def stage(name: str, state: StageState, **values: object) -> StageRun:
    return StageRun("job_1", name, "h", (), state, **values)  # type: ignore[arg-type]


class TestLeasePolicy:
    def test_a_stage_is_requeued_until_its_attempts_are_used_up(self) -> None:
        policy = LeasePolicy(max_attempts=3)
        assert [policy.after_expiry(n) for n in (1, 2, 3, 4)] == [
            StageState.QUEUED,
            StageState.QUEUED,
            StageState.FAILED,
            StageState.FAILED,
        ]

    @pytest.mark.parametrize("values", [{"heartbeat_s": 10.0}, {"heartbeat_s": 0.0}, {"max_attempts": 0}])
    def test_refuses_leases_that_a_single_late_heartbeat_would_lose(self, values: dict) -> None:
        with pytest.raises(ValueError):
            LeasePolicy(**values)


class TestEstimates:
    def test_a_running_stage_is_extrapolated_and_a_waiting_one_taken_as_usual(self) -> None:
        running = stage("a", StageState.RUNNING, fraction=0.25, started_at=100.0)
        waiting = stage("b", StageState.PENDING)
        assert remaining_s(job(running, waiting), {"b": 7.0}, now=110.0) == pytest.approx(30.0 + 7.0)

    def test_a_stage_tells_its_own_time_from_a_twentieth_on(self) -> None:
        running = stage("a", StageState.RUNNING, fraction=0.2, started_at=100.0)
        early = dataclasses.replace(running, fraction=0.04)
        assert stage_remaining_s(running, {}, now=110.0) == pytest.approx(40.0)
        assert stage_remaining_s(early, {}, now=110.0) is None
        assert stage_remaining_s(early, {"a": 25.0}, now=110.0) == pytest.approx(15.0)

    def test_says_nothing_where_a_stage_was_never_seen(self) -> None:
        assert remaining_s(job(stage("a", StageState.PENDING)), {}, now=0.0) is None

    def test_a_terminal_job_has_no_remaining_time(self) -> None:
        assert remaining_s(job(stage("a", StageState.SUCCEEDED), state=JobState.SUCCEEDED), {}, now=0.0) is None

    def test_the_fraction_weights_stages_by_their_usual_time(self) -> None:
        done, waiting = stage("a", StageState.REUSED), stage("b", StageState.PENDING)
        assert job_fraction(job(done, waiting), {"a": 1.0, "b": 9.0}) == pytest.approx(0.1)
        assert job_fraction(job(done, waiting), {}) == pytest.approx(0.5)
        assert job_fraction(job(done, done), {}) == 1.0


class TestRecords:
    def test_recordings_and_only_recordings_belong_to_a_camera(self) -> None:
        good = StoredFile("f", "s", Purpose.RECORDING, "north", "n.mp4", "", 1, "0" * 64, 0.0)
        with pytest.raises(ValueError, match="camera"):
            dataclasses.replace(good, camera_id="")
        with pytest.raises(ValueError, match="camera"):
            dataclasses.replace(good, purpose=Purpose.LABELS)

    def test_an_upload_never_has_more_bytes_than_promised(self) -> None:
        with pytest.raises(ValueError, match="offset"):
            Upload("u", "s", Purpose.LABELS, "", "l", length=5, offset=6, created_at=0.0, expires_at=1.0)
