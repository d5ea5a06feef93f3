"""How long a job will still take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from wibam_core.jobs.records import Job, StageRun
from wibam_core.jobs.states import StageState
from wibam_core.progress import remaining_s as at_this_pace_s


def remaining_s(job: Job, typical_s: Mapping[str, float], now: float) -> float | None:
    """Seconds until the job is done, or None while too little is known.

    Args:
        job: as it stands.
        typical_s: stage name -> how long it usually takes.
        now: Unix seconds.
    """
    if job.state.is_terminal:
        return None
    return _total(stage_remaining_s(stage, typical_s, now) for stage in job.stages)


def job_fraction(job: Job, typical_s: Mapping[str, float]) -> float:
    """How much of the job is done, in [0, 1]: stages weighted by how long they usually take, else equally."""
    known = [typical_s[stage.name] for stage in job.stages if stage.name in typical_s]
    usual = sum(known) / len(known) if known else 1.0
    weights = [max(typical_s.get(stage.name, usual), 1e-3) for stage in job.stages]
    done = [1.0 if stage.state.has_outputs else stage.fraction for stage in job.stages]
    return sum(w * d for w, d in zip(weights, done, strict=True)) / sum(weights) if weights else 0.0


def stage_remaining_s(stage: StageRun, typical_s: Mapping[str, float], now: float) -> float | None:
    """Seconds until one stage is done once it runs; see `remaining_s`."""
    if stage.state.is_terminal:
        return 0.0
    typical = typical_s.get(stage.name)
    if stage.state is not StageState.RUNNING or stage.started_at is None:
        return typical
    elapsed = now - stage.started_at
    left_s = at_this_pace_s(elapsed, stage.fraction)
    if left_s is not None or typical is None:
        return left_s
    return max(typical - elapsed, 0.0)


def _total(parts: Iterable[float | None]) -> float | None:
    total = 0.0
    for seconds in parts:
        if seconds is None:
            return None
        total += seconds
    return total
