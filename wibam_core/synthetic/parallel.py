"""Independent jobs in several processes, with progress; one worker runs them right here."""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait
from multiprocessing.queues import Queue
from typing import TypeVar

from wibam_core.progress import Progress

Job = TypeVar("Job")
Result = TypeVar("Result")

_updates: Queue | None = None


def run_jobs(
    work: Callable[[Job, Callable[[float], None]], Result],
    jobs: Sequence[Job],
    workers: int,
    progress: Progress,
) -> list[Result]:
    """``work(job, advance)`` of every job, results in the order of the jobs.

    Args:
        work: a function at module level; it calls ``advance`` with its share done, now and then.
        jobs: picklable where there is more than one worker.
        workers: number of processes.
        progress: told the mean share done.
    """
    done = [0.0] * len(jobs)

    def report(number: int, share: float) -> None:
        done[number] = share
        progress(sum(done) / len(done), f"rendering, {sum(s >= 1.0 for s in done)} of {len(done)} cameras done")

    if workers == 1 or len(jobs) == 1:
        results = []
        for number, job in enumerate(jobs):
            results.append(work(job, lambda share, number=number: report(number, share)))  # type: ignore[misc]
            report(number, 1.0)
        return results
    context = multiprocessing.get_context("spawn")
    updates = context.Queue()
    with ProcessPoolExecutor(
        min(workers, len(jobs)), mp_context=context, initializer=_keep_updates, initargs=(updates,)
    ) as pool:
        futures = [pool.submit(_run, work, number, job) for number, job in enumerate(jobs)]
        while True:
            finished, pending = wait(futures, timeout=0.5, return_when=FIRST_EXCEPTION)
            while True:
                try:
                    report(*updates.get_nowait())
                except queue.Empty:
                    break
            if not pending or any(future.exception() is not None for future in finished):
                break
        for future in pending:
            future.cancel()
        return [future.result() for future in futures]


def _keep_updates(updates: Queue) -> None:
    global _updates
    _updates = updates


def _run(work: Callable[[Job, Callable[[float], None]], Result], number: int, job: Job) -> Result:
    updates = _updates
    assert updates is not None
    result = work(job, lambda share: updates.put((number, share)))
    updates.put((number, 1.0))
    return result
