"""How well a job says how long it will still take: what `wibam run` shows, against what it then took.

All stages run in this process, in a folder that is removed at the end. Printed are what was foretold before the start,
then at each tenth of the job what was said to be left and what was; and of all reports from the first tenth on, the
share that was within 30 % of what was left (or 10 s), and the worst error as a share of the whole job.

With ``--cpu`` seconds are CPU seconds of this process, as on one idle core: on a machine with other work, time by the
clock says how busy that is.

Run: OMP_NUM_THREADS=1 python benchmarks/time_left.py SITE_DIR [--cpu] [--until STAGE] [--set stage.option=value ...]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from wibam_core.adapters.machine import this_machine
from wibam_core.cli.foretell import tried
from wibam_core.cli.run import parse_options
from wibam_core.config import PipelineConfig
from wibam_core.costs import Footage, Machine, expected_s
from wibam_core.stages.graph import STAGES
from wibam_core.stages.runner import SiteFolder, StageUpdate, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.video.header import said_length

TOLERANCE, LEAST_S = 0.3, 10.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site_dir", type=Path)
    parser.add_argument("--cpu", action="store_true")
    parser.add_argument("--until", choices=list(STAGES), help="stop after this stage")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.OPTION=VALUE")
    arguments = parser.parse_args()
    config, folder = PipelineConfig.parse(parse_options(arguments.set)), SiteFolder.load(arguments.site_dir)
    machine, clock = tried(this_machine()), time.monotonic
    if arguments.cpu:
        machine, clock = Machine(1, this_machine().bfloat16), time.process_time
    expected = expected_s(footage(folder, config), config, machine)
    wanted = list(STAGES)[: 1 + list(STAGES).index(arguments.until or "report")]
    said: list[tuple[float, float, str]] = []
    started = clock()

    def note(update: StageUpdate) -> None:
        if update.job_remaining_s is not None:
            said.append((clock() - started, update.job_remaining_s, update.stage))
        if update.state == "succeeded":
            print(f"{update.stage:<10}{update.seconds:8.1f} s, expected {expected[update.stage]:8.1f}", flush=True)

    with tempfile.TemporaryDirectory() as temporary:
        store = StageStore(Path(temporary))
        run_pipeline(folder, store, config, note, until=arguments.until, expected_s=expected, clock=clock)
    report(said, clock() - started, sum(expected[stage] for stage in wanted))


def footage(folder: SiteFolder, config: PipelineConfig) -> Footage:
    lengths = [[said_length(file.path) for file in recording.files] for recording in folder.recordings.values()]
    known = [[length for length in of_camera if length is not None] for of_camera in lengths]
    seconds = min(sum(length.seconds for length in of_camera) for of_camera in known)
    return Footage.of(folder.site, config, seconds, sum(length.frames for of_camera in known for length in of_camera))


def report(said: list[tuple[float, float, str]], total_s: float, foretold_s: float) -> None:
    print(f"foretold {foretold_s:.0f} s, took {total_s:.0f} s")
    at, left = (np.array(values) for values in zip(*((t, s) for t, s, _ in said), strict=True))
    for tenth in range(1, 10):
        row = min(int(np.searchsorted(at, tenth / 10 * total_s)), len(at) - 1)
        print(f"{tenth / 10:4.1f}  {said[row][2]:<10} said {left[row]:7.0f} s left, were {total_s - at[row]:7.0f}")
    late = at >= 0.1 * total_s
    error = np.abs(left - (total_s - at))[late]
    good = error <= np.maximum(TOLERANCE * (total_s - at[late]), LEAST_S)
    print(f"from the first tenth on: {good.mean():.1%} within {TOLERANCE:.0%}; worst error {error.max() / total_s:.1%}")


if __name__ == "__main__":
    main()
