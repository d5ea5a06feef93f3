from __future__ import annotations

import dataclasses

import pytest

from wibam_core.costs import Machine, Pace
from wibam_core.jobs.estimate import job_fraction, pace_of, remaining_s, stage_remaining_s, time_limit
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
    def test_a_running_stage_is_extrapolated_and_a_waiting_one_taken_as_expected(self) -> None:
        running = stage("a", StageState.RUNNING, fraction=0.25, started_at=100.0)
        waiting = stage("b", StageState.PENDING)
        pace = Pace({"a": 40.0, "b": 7.0}, {})
        assert remaining_s(job(running, waiting), pace, now=110.0) == pytest.approx(30.0 + 7.0)

    def test_what_stages_took_corrects_what_the_others_are_expected_to_take(self) -> None:
        waiting = stage("b", StageState.PENDING)
        twice_as_slow = Pace({"a": 100.0, "b": 50.0}, {"a": 200.0})
        left_s = stage_remaining_s(waiting, twice_as_slow, now=0.0)
        assert left_s == pytest.approx(100.0, rel=0.05)
        a_little = Pace({"a": 1.0, "b": 50.0}, {"a": 2.0})
        assert stage_remaining_s(waiting, a_little, now=0.0) == pytest.approx(50.0)
        one_odd = Pace({"a": 100.0, "b": 50.0, "c": 50.0, "d": 90.0}, {"a": 110.0, "c": 200.0, "d": 90.0})
        assert stage_remaining_s(waiting, one_odd, now=0.0) == pytest.approx(55.0)

    def test_a_stage_tells_its_own_time_from_a_twentieth_on(self) -> None:
        running = stage("a", StageState.RUNNING, fraction=0.2, started_at=100.0)
        early = dataclasses.replace(running, fraction=0.04)
        unknown = Pace({}, {})
        assert stage_remaining_s(running, unknown, now=110.0) == pytest.approx(40.0)
        assert stage_remaining_s(early, unknown, now=110.0) is None
        assert stage_remaining_s(early, Pace({"a": 25.0}, {}), now=110.0) == pytest.approx(24.0)

    def test_the_further_a_stage_is_the_more_its_own_pace_counts(self) -> None:
        pace = Pace({"a": 10.0}, {})
        far = [
            stage_remaining_s(stage("a", StageState.RUNNING, fraction=f, started_at=0.0), pace, now=100.0 * f)
            for f in (0.1, 0.5, 0.9)
        ]
        own = [90.0, 50.0, 10.0]
        shares = [found / wanted for found, wanted in zip(far, own, strict=True) if found is not None]
        assert shares == sorted(shares) and shares[0] == pytest.approx(0.55) and shares[2] > 0.9

    def test_says_nothing_of_stages_of_which_nothing_is_known(self) -> None:
        assert remaining_s(job(stage("a", StageState.PENDING)), Pace({}, {}), now=0.0) is None

    def test_a_terminal_job_has_no_remaining_time(self) -> None:
        ended = job(stage("a", StageState.SUCCEEDED), state=JobState.SUCCEEDED)
        assert remaining_s(ended, Pace({}, {}), now=0.0) is None

    def test_the_fraction_weights_stages_by_their_expected_time(self) -> None:
        done, waiting = stage("a", StageState.REUSED), stage("b", StageState.PENDING)
        assert job_fraction(job(done, waiting), Pace({"a": 1.0, "b": 9.0}, {})) == pytest.approx(0.1)
        assert job_fraction(job(done, waiting), Pace({}, {})) == pytest.approx(0.5)
        assert job_fraction(job(done, done), Pace({}, {})) == 1.0

    def test_a_job_is_expected_to_take_what_its_recordings_and_options_ask_for(self) -> None:
        ended = {"started_at": 0.0, "finished_at": 2.0, "summary": {"shortest_s": 60.0, "frames": 6000}}
        preflight = stage("preflight", StageState.SUCCEEDED, **ended)
        others = [stage(name, StageState.PENDING) for name in ("detect", "finetune")]
        machine = Machine(cores=2, bfloat16=True)
        known = pace_of(job(preflight, *others), machine)
        assert known.took_s == {"preflight": 2.0}
        assert set(known.expected_s) == {"preflight", "detect", "finetune"}
        halved = dataclasses.replace(job(preflight, *others), options={"finetune": {"steps": 600}})
        fewer = pace_of(halved, machine).expected_s
        assert fewer["detect"] == known.expected_s["detect"]
        assert fewer["finetune"] == pytest.approx(known.expected_s["finetune"] / 2, rel=0.1)
        reused = dataclasses.replace(others[0], state=StageState.REUSED)
        assert set(pace_of(job(preflight, reused), machine).expected_s) == {"preflight"}
        assert pace_of(job(*others), machine).expected_s == {}

    def test_a_stage_may_take_some_times_what_is_expected_on_a_machine_as_slow_as_it_has_shown(self) -> None:
        machine, summary = Machine(cores=2, bfloat16=False), {"shortest_s": 600.0, "frames": 60_000}
        ended = {"started_at": 0.0, "summary": summary}
        begun = job(stage("preflight", StageState.SUCCEEDED, finished_at=1.0, **ended))
        usual_s = pace_of(begun, machine).expected_s["preflight"]
        known = job(
            stage("preflight", StageState.SUCCEEDED, finished_at=usual_s, **ended), stage("sync", StageState.RUNNING)
        )
        slow = job(
            stage("preflight", StageState.SUCCEEDED, finished_at=7e5, **ended), stage("sync", StageState.RUNNING)
        )
        expected = pace_of(known, machine).expected_s["sync"]
        limit = time_limit(known, "sync", machine, most_s=1e9, times=10.0, least_s=1.0)
        assert (limit.seconds, limit.expected_s) == (pytest.approx(10.0 * expected), pytest.approx(expected))
        assert time_limit(slow, "sync", machine, most_s=1e9, times=10.0, least_s=1.0).seconds >= limit.seconds
        assert time_limit(known, "sync", machine, most_s=1e9, times=1e-9, least_s=77.0).seconds == 77.0
        for times, named in ((1e9, "sync"), (1.0, "track")):  # of a stage of which nothing is known, too
            limit = time_limit(known, named, machine, most_s=50.0, times=times, least_s=1.0)
            assert (limit.seconds, limit.expected_s) == (50.0, None)
        own = dataclasses.replace(
            job(
                stage("preflight", StageState.SUCCEEDED, finished_at=1.0, **ended), stage("detect", StageState.RUNNING)
            ),
            options={"detect": {"detector": "custom"}},
        )
        limit = time_limit(own, "detect", machine, most_s=1e9, times=1.0, least_s=1.0)
        assert limit.expected_s is None, "nobody knows how slow a detector of the user's own is"


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
