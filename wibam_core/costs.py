"""How long the stages of a job will take, from what is known before: the footage, the options, the machine.

What a stage costs grows with the pixels that are decoded, the images that networks see, and the steps of the training;
how much for each was measured (docs/performance.md). Nobody knows beforehand how many road users there will be, nor how
busy the machine is: once a job runs, what its stages took corrects what the others are expected to take (`Pace`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from wibam_core.config import PipelineConfig
from wibam_core.progress import remaining_s
from wibam_core.site import Site

#: Widest image that a network sees unless it is told otherwise, px, and its pixels per width: most footage is 16:9.
_NETWORK_WIDTH_PX, _HEIGHT_SHARE = 640, 9 / 16
#: Work that cores share: the others run on one.
_SHARED = frozenset({"sync", "frames", "detect", "rounds", "finetune", "predict", "evaluate"})
#: How often a detector finds so little that a round is run, as far as anybody knows before; a second is not expected.
_ROUNDS_EXPECTED = 0.5
#: Pixels of the windows that a round teaches by, as a share of the images'.
_WINDOWS = 0.16
#: The work of sharing, as a share of a core that is lost for each further one.
_LOST_SHARE = 0.15
#: That all goes as expected counts as much as stages that are so large a share of the whole.
_BELIEVED_SHARE = 0.2
#: A stage's own pace counts as much as what was expected of it once this share of it is done.
_KNOWN_FRACTION = 0.1


@dataclass(frozen=True)
class Machine:
    """What stages run on.

    Attributes:
        cores: that they may use.
        bfloat16: whether the processor multiplies in it.
        slowness: how long one core takes for what one of the machine takes a second on which costs were measured.
    """

    cores: int
    bfloat16: bool
    slowness: float = 1.0


@dataclass(frozen=True)
class Footage:
    """What a job works on.

    Attributes:
        cameras: how many.
        seconds: how long all of them record.
        frames: of all recordings.
        megapixels: of all these frames.
        stored_megapixels: of one frame as it is stored.
        has_signals: traffic lights are watched.
    """

    cameras: int
    seconds: float
    frames: int
    megapixels: float
    stored_megapixels: float
    has_signals: bool

    @classmethod
    def of(cls, site: Site, config: PipelineConfig, seconds: float, frames: int) -> Footage:
        """That of a site whose recordings last so long and have so many frames in all."""
        count = len(site.cameras)
        sizes = [camera.width_px * camera.height_px / 1e6 for camera in site.cameras]
        shrunk = [min(1.0, config.frames.width_px / camera.width_px) ** 2 for camera in site.cameras]
        return cls(
            count,
            seconds,
            frames,
            frames * sum(sizes) / count,
            sum(size * share for size, share in zip(sizes, shrunk, strict=True)) / count,
            any(camera.signals for camera in site.cameras),
        )


def expected_s(
    footage: Footage, config: PipelineConfig, machine: Machine, rounds: float = _ROUNDS_EXPECTED
) -> dict[str, float]:
    """Stage -> seconds that it will take by the clock, by itself on that machine.

    ``rounds`` says how many rounds of finding and teaching are expected where the options allow any.
    """
    effective = 1.0 + (machine.cores - 1) * (1.0 - _LOST_SHARE)
    return {
        stage: machine.slowness * (seconds / effective if stage in _SHARED else seconds)
        for stage, seconds in _cpu_s(footage, config, machine.bfloat16, rounds).items()
    }


def _cpu_s(footage: Footage, config: PipelineConfig, bfloat16: bool, rounds: float) -> dict[str, float]:
    """Stage -> CPU seconds on the machine where they were measured."""
    minutes = footage.seconds / 60
    decoding = 0.0032 * footage.megapixels + 0.0002 * footage.frames
    network = (_NETWORK_WIDTH_PX**2 * _HEIGHT_SHARE) / 1e6  # megapixels of an image
    per_second = footage.cameras * footage.seconds
    stored = min(config.frames.rate_hz, footage.frames / max(per_second, 1e-9)) * per_second
    searched = min(config.detect.rate_hz * per_second, stored)
    dataset = min(config.dataset.rate_hz * per_second, stored)
    of_test = max(1.0 - config.dataset.train_share - config.dataset.val_share, 0.0) * dataset
    tracked = min(config.track.rate_hz * per_second, stored)
    decoded_jpeg = 0.003 * footage.stored_megapixels
    found, looked_at = 0.0075, 0.0185  # an image: the detector, and the second look at what it finds
    asks_lights = footage.has_signals and config.sync.method != "traffic"
    # where the lights may be enough, every other frame of the traffic is looked at beside them
    only_decides = footage.has_signals and config.sync.method == "auto"
    watched = min(config.sync.traffic_rate_hz / (1 + only_decides) * per_second, stored)
    watched *= config.sync.method != "signals"
    image = 0.033 * network / 0.23  # the 3D network and its second look, an image
    of_val = max(config.dataset.val_share, 0.0) * footage.seconds + 2 * config.dataset.gap_s
    # associated, and fitted without each camera in turn where that judges
    judging = (0.7 * minutes + 3.3 * min(of_val / 60, minutes)) * footage.cameras / 4
    fitting = judging + 2.5 * minutes * config.dataset.train_share * footage.cameras / 4
    moving = decoded_jpeg + 0.02  # silhouettes in an image, and a second look at those that are new
    refining = 0.0 if config.refine.method == "none" else 1.0 + 4.0 * min(minutes, 5.0) * footage.cameras / 4
    teaching = 3.0 + (0.056 if bfloat16 else 0.21) * _WINDOWS * 8 * config.rounds.steps
    return {
        "preflight": 0.6 + 1e-4 * footage.frames,
        "calibrate": 0.3,
        "sync": 0.0
        if config.sync.method == "none"
        else 0.5 + decoding + asks_lights * 0.0004 * footage.frames + found * watched,
        "frames": 0.5 + decoding + 0.004 * footage.stored_megapixels * stored,
        "detect": 1.0 + (found + decoded_jpeg) * searched + (config.detect.refine != "off") * looked_at * searched,
        "rounds": 0.3
        if not config.rounds.asked_for
        else 1.5
        + refining
        + judging
        + (rounds > 0) * config.rounds.motion * (moving * searched + judging)
        + rounds * bool(config.rounds.most) * (fitting + teaching + (image + decoded_jpeg + looked_at) * searched),
        # what the detector's boxes say of the cameras stands where rounds find no others
        "refine": 0.5 + (min(rounds, 1.0) if config.rounds.asked_for else 1.0) * refining,
        "associate": 0.3 + 0.7 * minutes * footage.cameras / 4,
        "dataset": 0.3,
        "lift": 0.5 + 2.5 * minutes * footage.cameras / 4,
        "finetune": 5.0 + _training_cpu_s(config, network, bfloat16) + decoded_jpeg * dataset,
        "predict": 1.0 + (image + decoded_jpeg) * (tracked + of_test),
        "evaluate": 2.5 + (image + decoded_jpeg) * of_test,
        "track": 0.4 + 0.0006 * tracked,
        "safety": 1.0 + 1.5 * minutes,
        "report": 3.5 + minutes,
    }


def _training_cpu_s(config: PipelineConfig, network: float, bfloat16: bool) -> float:
    """Of all steps; a step on windows costs as much less as they have less pixels.

    Their sides are rounded up, and they are larger where a vehicle does not fit: 1.4 times the share that is asked for.
    """
    options = config.finetune
    whole = (options.input_width_px or _NETWORK_WIDTH_PX) ** 2 * _HEIGHT_SHARE / 1e6
    per_image = (0.056 if bfloat16 else 0.21) * whole / 0.23
    return per_image * options.batch_size * options.steps * min(1.4 * options.crop_share**2, 1.0)


@dataclass(frozen=True)
class Pace:
    """How a job goes on, against what was expected of it.

    Attributes:
        expected_s: stage -> what it is expected to take, of all stages that this job has to make, made or not.
        took_s: of those that it has made: how long they took.
    """

    expected_s: Mapping[str, float]
    took_s: Mapping[str, float]

    @property
    def ratio(self) -> float:
        """How much longer than expected everything takes: the median of the stages', each as heavy as it was long.

        Some stages are hard to foresee, which says nothing of the others.
        """
        found = [(1.0, _BELIEVED_SHARE * sum(self.expected_s.values()))]
        found += [
            (self.took_s[stage] / expected, expected)
            for stage, expected in self.expected_s.items()
            if stage in self.took_s and expected > 0
        ]
        half, weight = sum(expected for _, expected in found) / 2, 0.0
        for ratio, expected in sorted(found):
            weight += expected
            if weight >= half:
                return ratio
        return 1.0

    def stage_left_s(self, stage: str, elapsed_s: float = 0.0, fraction: float = 0.0) -> float | None:
        """How long (s) a stage will still take that has run for so long and done this share of its work."""
        own = remaining_s(elapsed_s, fraction)
        if stage not in self.expected_s:
            return own
        expected = max(self.ratio * self.expected_s[stage] * (1.0 - fraction), 0.0)
        if own is None:
            return expected
        trust = fraction / (fraction + _KNOWN_FRACTION)
        return trust * own + (1.0 - trust) * expected
