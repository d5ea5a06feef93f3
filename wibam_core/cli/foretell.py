"""How long a job will take on this machine, said before it starts."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

from rich.console import Console

from wibam_core.adapters.machine import this_machine
from wibam_core.cli.display import time_left
from wibam_core.config import PipelineConfig
from wibam_core.costs import Footage, Machine, expected_s
from wibam_core.stages.graph import STAGES
from wibam_core.stages.runner import SiteFolder
from wibam_core.synthetic.options import SimulationOptions

#: How often the speed is tried, and how long one try takes on the machine where costs were measured, s.
_TRIES, _TRY_S = 20, 0.007
#: What rendering and encoding a megapixel takes there, s.
_RECORDING_S = 0.045


def foretold(folder: SiteFolder, config: PipelineConfig) -> dict[str, float]:
    """Stage -> seconds that it is expected to take here; nothing where the recordings do not say how long they are.

    What is wrong with a recording is for the first stage to say.
    """
    from wibam_core.video.header import said_length  # libavcodec takes a tenth of a second to load

    lengths = [[said_length(file.path) for file in recording.files] for recording in folder.recordings.values()]
    if not lengths or any(length is None for of_camera in lengths for length in of_camera):
        return {}
    known = [[length for length in of_camera if length is not None] for of_camera in lengths]
    seconds = min(sum(length.seconds for length in of_camera) for of_camera in known)
    frames = sum(length.frames for of_camera in known for length in of_camera)
    return expected_s(Footage.of(folder.site, config, seconds, frames), config, tried(this_machine()))


def foretold_demo(options: SimulationOptions, config: PipelineConfig) -> float:
    """Seconds that recording a simulated site, and a job on it, are expected to take here."""
    frames = round(options.cameras * options.fps * options.seconds)
    megapixels = options.width_px * options.height_px / 1e6
    footage = Footage(options.cameras, options.seconds, frames, frames * megapixels, megapixels, has_signals=True)
    machine = tried(this_machine())
    recording = machine.slowness * _RECORDING_S * frames * megapixels / min(options.workers, machine.cores)
    # the bundled detector learned from such sites and overlooks little there
    return recording + sum(expected_s(footage, config, machine, rounds=0.0).values())


def print_foretold(
    console: Console, expected: Mapping[str, float], to_make: Sequence[str], until: str | None = None
) -> None:
    """Say how long the stages that are to be made will take, where that is known."""
    names = list(STAGES)
    last = len(names) if until is None else names.index(until) + 1
    wanted = [name for name in to_make if name in names[:last]]
    if not wanted or any(name not in expected for name in wanted):
        return
    seconds = sum(expected[name] for name in wanted)
    longest = max(wanted, key=lambda name: expected[name])
    share = expected[longest] / seconds
    console.print(
        f"It will take about {time_left(seconds)} on this machine, {share:.0%} of it to"
        f" {STAGES[longest].title[0].lower()}{STAGES[longest].title[1:]}.",
        highlight=False,
    )


def tried(machine: Machine) -> Machine:
    """The machine with how slow one of its cores is just now: a few passes of the bundled detector on one thread.

    That takes a few tenths of a second, or more where the machine is busy, which is what it finds out.
    """
    import numpy as np
    import onnxruntime

    from wibam_core.detection.detector import BUNDLED

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(BUNDLED), options, providers=["CPUExecutionProvider"])
    images = {"image": np.full((1, 3, 384, 640), 0.5, np.float32)}
    session.run(None, images)
    started = time.monotonic()
    for _ in range(_TRIES):
        session.run(None, images)
    return replace(machine, slowness=(time.monotonic() - started) / (_TRIES * _TRY_S))
