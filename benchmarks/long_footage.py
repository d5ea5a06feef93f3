"""How fast a network runs on new footage, and how memory grows with its length.

``python -m benchmarks.long_footage SITE --cameras north`` takes recordings of a site folder for footage as long as
asked for: each is given again and again, as files that follow each other. Each length is run in a process of its own;
its CPU time, wall time and largest memory are printed, and the CPU time of each stage.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path

from wibam_core.config import PipelineConfig
from wibam_core.job_kind import JobKind
from wibam_core.models.weights import bundled
from wibam_core.stages.runner import SiteFolder, StageUpdate, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.video.probe import probe
from wibam_core.video.recording import Recording, RecordingFile

_BEGIN_NS = 1_782_885_600_000_000_000


def repeated(path: Path, minutes: float) -> Recording:
    """A recording given so often that it lasts so long."""
    info = probe(path)
    lasts_ns = round(info.duration_s * 1e9)
    count = max(1, round(minutes * 60 / info.duration_s))
    return Recording(
        tuple(RecordingFile(path, f"{n:05d}{path.suffix}", _BEGIN_NS + n * lasts_ns) for n in range(count))
    )


def measure(site_dir: Path, cameras: list[str], minutes: float, model: Path, rate_hz: float) -> dict[str, float]:
    """Run once, in this process."""
    folder = SiteFolder.load(site_dir)
    chosen = tuple(camera for camera in folder.site.cameras if camera.id in cameras)
    recordings = {camera.id: repeated(folder.recordings[camera.id].files[0].path, minutes) for camera in chosen}
    site = folder.site.model_copy(update={"cameras": chosen})
    options = {"sync": {"method": "none"}, "track": {"rate_hz": rate_hz}, "preflight": {"min_overlap_s": 1.0}}
    marks = {"begin": time.process_time()}

    def listen(update: StageUpdate) -> None:
        if update.state == "succeeded":
            marks[update.stage] = time.process_time()

    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as store:
        given = SiteFolder(site, recordings, {"model": model})
        result = run_pipeline(given, StageStore(Path(store)), PipelineConfig.parse(options), listen, kind=JobKind.RUN)
    names = list(marks)
    return {
        "minutes": minutes,
        "images": result.summaries["track"]["instants"] * len(chosen),
        "tracks": result.summaries["track"]["tracks"],
        "wall_s": round(time.perf_counter() - started, 1),
        "cpu_s": round(marks[names[-1]] - marks["begin"], 1),
        **{f"cpu_{b}_s": round(marks[b] - marks[a], 1) for a, b in pairwise(names)},
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", type=Path, help="a site's folder")
    parser.add_argument("--cameras", nargs="+", required=True, help="ids of its cameras")
    parser.add_argument("--minutes", nargs="+", type=float, default=[10.0, 60.0])
    parser.add_argument("--rate", type=float, default=PipelineConfig().track.rate_hz, help="images a second")
    parser.add_argument("--model", type=Path, default=bundled("mono_small.safetensors"))
    parser.add_argument("--here", action="store_true", help="run the first length in this process")
    asked = parser.parse_args()
    if asked.here:
        print(json.dumps(measure(asked.site, asked.cameras, asked.minutes[0], asked.model, asked.rate)))
        return
    for minutes in asked.minutes:
        command = [
            sys.executable,
            "-m",
            "benchmarks.long_footage",
            str(asked.site),
            "--here",
            "--minutes",
            str(minutes),
        ]
        command += ["--rate", str(asked.rate), "--model", str(asked.model), "--cameras", *asked.cameras]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        print(done.stdout.strip().splitlines()[-1], flush=True)


if __name__ == "__main__":
    main()
