"""The state machine of jobs: its tables, and its laws under any order of events."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wibam_core.jobs.machine import (
    JOB_MOVES,
    STAGE_MOVES,
    IllegalMove,
    StageNode,
    cancel,
    check_job_move,
    check_stage_move,
    settle,
)
from wibam_core.jobs.states import JobState, StageState

DIAMOND = (("a", ()), ("b", ("a",)), ("c", ("a",)), ("d", ("b", "c")), ("e", ("d",)))
_ENDS = (StageState.SUCCEEDED, StageState.REUSED, StageState.FAILED)


def nodes(states: dict[str, StageState]) -> list[StageNode]:
    return [StageNode(name, states[name], requires) for name, requires in DIAMOND]


def fresh() -> dict[str, StageState]:
    return {name: StageState.PENDING for name, _ in DIAMOND}


class TestTables:
    @pytest.mark.parametrize(("before", "after"), list(itertools.product(JobState, JobState)))
    def test_every_job_move_is_either_in_the_table_or_refused(self, before: JobState, after: JobState) -> None:
        if after in JOB_MOVES[before]:
            check_job_move(before, after)
        else:
            with pytest.raises(IllegalMove):
                check_job_move(before, after)

    @pytest.mark.parametrize(("before", "after"), list(itertools.product(StageState, StageState)))
    def test_every_stage_move_is_either_in_the_table_or_refused(self, before: StageState, after: StageState) -> None:
        if after in STAGE_MOVES[before]:
            check_stage_move(before, after)
        else:
            with pytest.raises(IllegalMove):
                check_stage_move(before, after)

    def test_terminal_states_are_left_by_a_restart_alone(self) -> None:
        for job_state in JobState:
            if job_state.is_terminal:
                assert JOB_MOVES[job_state] == {JobState.QUEUED}
        for stage_state in StageState:
            if stage_state.is_terminal:
                assert STAGE_MOVES[stage_state] == {StageState.PENDING}

    def test_every_state_can_be_reached_from_the_first_one(self) -> None:
        def reach(moves: dict, start: object) -> set:
            found = {start}
            while new := {after for state in found for after in moves[state]} - found:
                found |= new
            return found

        assert reach(dict(JOB_MOVES), JobState.QUEUED) == set(JobState)
        assert reach(dict(STAGE_MOVES), StageState.PENDING) == set(StageState)


class TestSettle:
    def test_a_fresh_job_queues_what_requires_nothing(self) -> None:
        result = settle(JobState.QUEUED, nodes(fresh()))
        assert result.queued == ("a",)
        assert result.job is JobState.QUEUED

    def test_branches_are_queued_together_and_join(self) -> None:
        states = fresh() | {"a": StageState.REUSED}
        assert settle(JobState.RUNNING, nodes(states)).queued == ("b", "c")
        states |= {"b": StageState.SUCCEEDED, "c": StageState.RUNNING}
        assert settle(JobState.RUNNING, nodes(states)).queued == ()
        states["c"] = StageState.SUCCEEDED
        assert settle(JobState.RUNNING, nodes(states)).queued == ("d",)

    def test_a_job_does_not_fail_while_a_stage_of_it_runs(self) -> None:
        states = fresh() | {"a": StageState.SUCCEEDED, "b": StageState.FAILED, "c": StageState.RUNNING}
        result = settle(JobState.RUNNING, nodes(states))
        assert result.job is JobState.RUNNING
        states["c"] = StageState.CANCELLED
        assert settle(JobState.RUNNING, nodes(states)).job is JobState.FAILED

    def test_a_failure_parks_what_was_queued(self) -> None:
        states = fresh() | {"a": StageState.SUCCEEDED, "b": StageState.FAILED, "c": StageState.QUEUED}
        assert settle(JobState.RUNNING, nodes(states)).moves == {"c": StageState.PENDING}

    def test_a_job_that_has_not_started_is_cancelled_at_once(self) -> None:
        states = fresh() | {"a": StageState.QUEUED}
        result = cancel(JobState.QUEUED, nodes(states))
        assert result.job is JobState.CANCELLED
        assert set(result.moves.values()) == {StageState.CANCELLED}
        assert set(result.moves) == set(states)

    def test_cancelling_waits_for_what_runs(self) -> None:
        states = fresh() | {"a": StageState.RUNNING}
        result = cancel(JobState.RUNNING, nodes(states))
        assert result.job is JobState.CANCELLING
        assert result.moves == dict.fromkeys(set(states) - {"a"}, StageState.CANCELLED)

    @pytest.mark.parametrize("state", [state for state in JobState if state.is_terminal])
    def test_cancelling_a_terminal_job_changes_nothing(self, state: JobState) -> None:
        result = cancel(state, nodes(fresh()))
        assert (result.job, result.moves) == (state, {})


@given(st.data())
def test_any_order_of_events_ends_legally_and_never_with_a_running_stage(data: st.DataObject) -> None:
    """Walk at random: claim, end, lose or cancel; every move must be in the tables, and the walk must end."""
    job, states = JobState.QUEUED, fresh()
    lost = 0

    def apply(result) -> None:
        nonlocal job
        for name, state in result.moves.items():
            check_stage_move(states[name], state)
            states[name] = state
        if result.job is not job:
            check_job_move(job, result.job)
            job = result.job

    apply(settle(job, nodes(states)))
    for _ in range(60):
        assert not (job.is_terminal and StageState.RUNNING in states.values())
        if job.is_terminal:
            break
        queued = [n for n, s in states.items() if s is StageState.QUEUED]
        running = [n for n, s in states.items() if s is StageState.RUNNING]
        actions = [("claim", n) for n in queued] + [("end", n) for n in running]
        actions += [("lose", n) for n in running if lost < 5]
        if job is not JobState.CANCELLING:
            actions.append(("cancel", ""))
        assert queued or running, "a job that is not terminal always has something to do"
        action, name = data.draw(st.sampled_from(actions))
        if action == "cancel":
            apply(cancel(job, nodes(states)))
            continue
        if action == "claim":
            after = StageState.RUNNING
            if job is JobState.QUEUED:
                check_job_move(job, JobState.RUNNING)
                job = JobState.RUNNING
        elif action == "lose":
            lost += 1
            after = StageState.CANCELLED if job is JobState.CANCELLING else StageState.QUEUED
        else:
            unwanted = job is JobState.CANCELLING or StageState.FAILED in states.values()
            after = data.draw(st.sampled_from([*_ENDS, *([StageState.CANCELLED] if unwanted else [])]))
        check_stage_move(states[name], after)
        states[name] = after
        apply(settle(job, nodes(states)))
    assert job.is_terminal
    if job is JobState.SUCCEEDED:
        assert all(state.has_outputs for state in states.values())
    if job is JobState.FAILED:
        assert StageState.FAILED in states.values()
    assert StageState.QUEUED not in states.values()
