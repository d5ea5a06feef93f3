"""How fast `GET /v1/jobs` answers with many jobs.

``python -m benchmarks.job_list``: makes jobs that have succeeded, with all stages, warnings and what a stage says about
its result, in a database of its own, and asks an API in this process for them over HTTP. CPU time is that of the whole
process, the client's share included, and does not depend on what else the machine does; the time on the clock does.
"""

from __future__ import annotations

import argparse
import gc
import tempfile
import time
from pathlib import Path

import numpy as np
from sqlalchemy import update

from tests.service import LiveApi, live_api, settings_for
from wibam_core.adapters.models import JobRow, StageRow
from wibam_core.adapters.planning import plan_stages
from wibam_core.documents.warnings import StageWarning
from wibam_core.jobs.states import JobState, StageState

_SUMMARY = {f"figure_{number}": number * 1.5 for number in range(12)}
_WARNING = StageWarning(
    stage="associate", code="few_views", message="few road users are seen by two cameras", hint="Turn one of them."
)


def fill(api: LiveApi, jobs: int) -> None:
    """Jobs of one site with four cameras that have succeeded."""
    services = api.services
    site_id = api.site(4)
    for number in range(1, 5):
        api.upload(site_id, b"a recording", f"cam{number}")
    site, files = services.sites.site(site_id), services.sites.files(site_id)
    plan = plan_stages(site.site, {}, files)
    for number in range(jobs):
        services.jobs.create(site, {}, files, plan, name=f"job {number}", tags=["benchmark"])
    warnings = [_WARNING.model_dump(mode="json")]
    ended = {"fraction": 1.0, "summary": _SUMMARY, "warnings": warnings, "started_at": 1.0, "finished_at": 9.0}
    with services.database.writing() as session:
        session.execute(update(StageRow).values(state=StageState.SUCCEEDED.value, **ended))
        session.execute(update(JobRow).values(state=JobState.SUCCEEDED.value, started_at=1.0, finished_at=99.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=30)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, live_api(settings_for(Path(folder))) as api:
        fill(api, arguments.jobs)
        gc.collect()
        gc.freeze()  # as a service of its own does at its start
        cpu_ms, wall_ms, size = [], [], 0
        for _ in range(arguments.rounds + 1):
            started, cpu = time.perf_counter(), time.process_time()
            answer = api.http.get("/v1/jobs", params={"limit": 1000})
            cpu_ms.append(1000.0 * (time.process_time() - cpu))
            wall_ms.append(1000.0 * (time.perf_counter() - started))
            size = len(answer.content)
            assert len(answer.json()) == arguments.jobs
        for name, taken in (("CPU", cpu_ms[1:]), ("clock", wall_ms[1:])):
            median, p95 = np.percentile(taken, [50, 95])
            print(f"{arguments.jobs} jobs, {size / 1e6:.2f} MB, {name}: median {median:.0f} ms, 95 % {p95:.0f} ms")


if __name__ == "__main__":
    main()
