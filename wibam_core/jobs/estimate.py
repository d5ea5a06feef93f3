"""How much of a job is done, and how long it will still take."""

from __future__ import annotations

from dataclasses import dataclass

from wibam_core.config import PipelineConfig
from wibam_core.costs import Footage, Machine, Pace, expected_s
from wibam_core.errors import StageTimedOut, TooCostly, WibamError
from wibam_core.job_kind import JobKind
from wibam_core.jobs.records import Job, StageRun
from wibam_core.jobs.states import StageState

#: Frames a second of a recording whose frames nobody has counted.
_USUAL_FPS = 25
#: What says whether the 2D detector and the 3D network are the user's own.
_NETWORK_OPTIONS = (("detect", "detector"), ("finetune", "network"))


def pace_of(job: Job, machine: Machine) -> Pace:
    """What the stages that a job makes are expected to take, and what those took that have ended.

    Nothing is expected before the recordings were looked at.
    """
    made = [stage for stage in job.stages if stage.state is not StageState.REUSED]
    expected = _expected_s(job, machine)
    return Pace(
        {stage.name: expected[stage.name] for stage in made if stage.name in expected},
        {
            stage.name: stage.finished_at - stage.started_at
            for stage in made
            if stage.state is StageState.SUCCEEDED and stage.started_at is not None and stage.finished_at is not None
        },
    )


def remaining_s(job: Job, pace: Pace, now: float) -> float | None:
    """Seconds until the job is done, or None while too little is known.

    Args:
        job: as it stands.
        pace: of the job.
        now: Unix seconds.
    """
    if job.state.is_terminal:
        return None
    total = 0.0
    for stage in job.stages:
        left_s = stage_remaining_s(stage, pace, now)
        if left_s is None:
            return None
        total += left_s
    return total


def job_fraction(job: Job, pace: Pace) -> float:
    """How much of the job is done, in [0, 1]: stages weighted by how long they are expected to take, else equally."""
    known = [pace.expected_s[stage.name] for stage in job.stages if stage.name in pace.expected_s]
    usual = sum(known) / len(known) if known else 1.0
    weights = [max(pace.expected_s.get(stage.name, usual), 1e-3) for stage in job.stages]
    done = [1.0 if stage.state.has_outputs else stage.fraction for stage in job.stages]
    return sum(w * d for w, d in zip(weights, done, strict=True)) / sum(weights) if weights else 0.0


def stage_remaining_s(stage: StageRun, pace: Pace, now: float) -> float | None:
    """Seconds until one stage is done once it runs; see `remaining_s`."""
    if stage.state.is_terminal:
        return 0.0
    running = stage.state is StageState.RUNNING and stage.started_at is not None
    elapsed_s = now - stage.started_at if running and stage.started_at is not None else 0.0
    return pace.stage_left_s(stage.name, elapsed_s, stage.fraction if running else 0.0)


@dataclass(frozen=True)
class TimeLimit:
    """How long a stage may take by the clock.

    Attributes:
        seconds: so long.
        expected_s: what it is expected to take, where that is what the limit follows from.
    """

    seconds: float
    expected_s: float | None = None

    def error(self, stage: str) -> StageTimedOut:
        """What a job is told whose stage took longer."""
        if self.expected_s is None:
            return StageTimedOut(f"the stage {stage} took longer than {self.seconds:g} s", seconds=self.seconds)
        return StageTimedOut(
            f"the stage {stage} took longer than {self.seconds:.3g} s, though {self.expected_s:.3g} s were expected",
            hint="Something in the recordings, or on the machine, holds it up: look at the job's log. A restart begins "
            "at this stage. Whoever runs the service can allow more (WIBAM_STAGE_TIMES_EXPECTED).",
            seconds=self.seconds,
            expected_s=self.expected_s,
        )


def time_limit(job: Job, stage: str, machine: Machine, most_s: float, times: float, least_s: float) -> TimeLimit:
    """How long a stage of a job may take.

    Args:
        job: as it stands.
        stage: which.
        machine: that works on it.
        most_s: no stage may take longer.
        times: nor so many times as long as is expected of it, on a machine that is as slow as the job's stages so far
            have shown.
        least_s: but every stage may take so long.
    """
    pace = pace_of(job, machine)
    if stage not in pace.expected_s or stage in _of_unknown_networks(job):
        return TimeLimit(most_s)
    expected = pace.expected_s[stage] * max(pace.ratio, 1.0)
    by_estimate = max(times * expected, least_s)
    return TimeLimit(most_s) if by_estimate >= most_s else TimeLimit(by_estimate, expected)


def _of_unknown_networks(job: Job) -> frozenset[str]:
    """Stages that run a network of the user's own, which may be as slow as it likes: estimates are of ours."""
    detector, network = (job.options.get(stage, {}).get(name) for stage, name in _NETWORK_OPTIONS)
    of_detector = {"detect"} if detector == "custom" else set()
    return frozenset(of_detector | ({"finetune", "predict", "evaluate"} if network == "custom" else set()))


def check_cost(job: Job, machine: Machine, allowed_s: float) -> None:
    """Refuse a job that is expected to take too long. Before its recordings were looked at, nothing is expected.

    Args:
        job: as it stands.
        machine: that works on it.
        allowed_s: what is left of it may take so long.

    Raises:
        TooCostly: it is expected to take longer.
    """
    expected = _expected_s(job, machine)
    left = {stage.name: expected.get(stage.name, 0.0) for stage in job.stages if not stage.state.has_outputs}
    total_s = sum(left.values())
    if total_s > allowed_s:
        longest = max(left, key=left.__getitem__)
        raise TooCostly(
            f"the job would take about {total_s / 3600:.3g} h on this machine, {allowed_s / 3600:.3g} h are allowed; "
            f"its stage {longest} alone takes {left[longest] / 3600:.3g} h",
            expected_s=round(total_s),
            allowed_s=round(allowed_s),
            stages_s={name: round(seconds) for name, seconds in left.items()},
        )


def _expected_s(job: Job, machine: Machine) -> dict[str, float]:
    if job.kind is JobKind.RUN:  # its stages do other work under the same names; how far they are tells their pace
        return {}
    preflight = job.stage("preflight")
    said = {} if preflight is None else preflight.summary or {}
    if "shortest_s" not in said:
        return {}
    try:
        config = PipelineConfig.parse(job.options)
    except WibamError:  # another version made the job
        return {}
    seconds = float(said["shortest_s"])
    frames = int(said.get("frames", _USUAL_FPS * seconds * len(job.site.cameras)))
    return expected_s(Footage.of(job.site, config, seconds, frames), config, machine)
