"""Fine-tune the small network on a site's multi-view boxes. Seeded, and resumable to the bit on one machine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from wibam_core.config import FinetuneConfig
from wibam_core.errors import NoMultiViewVehicles, NonFiniteLoss, TooFewInstants
from wibam_core.formats.framestore import FrameStore
from wibam_core.models.inference import to_input
from wibam_core.models.small import SmallNetwork, SmallOutputs
from wibam_core.progress import Progress
from wibam_core.scene import CameraRig
from wibam_core.training.augment import jitter_colour, mirror, shake
from wibam_core.training.checkpoint import read_checkpoint, write_checkpoint
from wibam_core.training.dataset import ImageCache, SiteView
from wibam_core.training.objectives import LiftedObjective, Objective, OtherCameras, PaperObjective
from wibam_core.training.schedule import CosineSchedule, LearningRateSchedule, PlateauSchedule
from wibam_core.training.targets import encode
from wibam_core.training.views import LabelledView

_GRADIENT_CLIP = 5.0

#: Of the views; the others are seen as the camera hangs, as they will be after training.
_SHAKEN_SHARE = 0.3
_WEIGHT_DECAY = 1e-3

#: Peak learning rates where the options give none.
_DEFAULT_RATE = {"lifted": 2.5e-3, "paper": 1e-4}

#: Validation looks at this many views at most, evenly spread.
_MAX_VALIDATION_VIEWS = 96

#: The last weights are kept unless their validation loss is worse than the best by more than this share.
_TOLERATED_RISE = 0.03


@dataclass(frozen=True, eq=False)
class SiteDataset:
    """What fine-tuning reads.

    Attributes:
        frames: the images. rig: cameras, of the recording's pixels.
        train, validation: labelled frames; validation may be empty.
    """

    frames: FrameStore
    rig: CameraRig
    train: Sequence[SiteView]
    validation: Sequence[SiteView]


@dataclass(frozen=True)
class Epoch:
    """Mean losses of one epoch; ``validation`` is empty without validation views."""

    step: int
    learning_rate: float
    train: dict[str, float]
    validation: dict[str, float]


@dataclass(frozen=True, eq=False)
class FinetuneResult:
    """The fine-tuned network in evaluation mode, the losses of all epochs, and which epoch's weights were kept."""

    network: SmallNetwork
    epochs: tuple[Epoch, ...]
    kept: Literal["last", "best"]
    kept_step: int


def finetune(
    network: SmallNetwork, dataset: SiteDataset, config: FinetuneConfig, progress: Progress, scratch: Path
) -> FinetuneResult:
    """Train ``network`` in place and return it.

    Args:
        network: where to start from.
        dataset: labelled frames.
        config: method, decoding, steps, batch size, learning rate, seed.
        progress: told after every step.
        scratch: keeps a checkpoint after every epoch; training goes on from there, equal to the bit.

    Raises:
        TooFewInstants: there is no frame to train on.
        NoMultiViewVehicles: no frame has a vehicle that teaches 3D.
        NonFiniteLoss: naming the step and the frames.
    """
    _check(dataset, config)
    scratch.mkdir(parents=True, exist_ok=True)
    training = _Training(network, dataset, config, scratch)
    training.resume()
    while training.step < config.steps:
        training.run_epoch(progress)
    return training.result()


def _check(dataset: SiteDataset, config: FinetuneConfig) -> None:
    if not dataset.train:
        raise TooFewInstants("the training part of the split has no frame")
    if config.method == "lifted":
        taught = any((view.labels.confidence > 0).any() for view in dataset.train)
    else:
        taught = any(len(view.other_vehicle) for view in dataset.train)
    if not taught:
        raise NoMultiViewVehicles("no vehicle in the training part of the split could be placed in 3D from two cameras")


def _objective(config: FinetuneConfig) -> Objective:
    return LiftedObjective(config.decode) if config.method == "lifted" else PaperObjective(config.decode)


def _schedule(config: FinetuneConfig) -> LearningRateSchedule:
    rate = config.learning_rate or _DEFAULT_RATE[config.method]
    return CosineSchedule(rate, config.steps) if config.method == "lifted" else PlateauSchedule(rate)


class _Training:
    """The state of one fine-tuning between epochs."""

    def __init__(self, network: SmallNetwork, dataset: SiteDataset, config: FinetuneConfig, scratch: Path) -> None:
        self.step = 0
        self._network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._config = config
        self._scratch = scratch
        self._train = dataset.train
        stride = max(1, -(-len(dataset.validation) // _MAX_VALIDATION_VIEWS))
        self._validation = dataset.validation[::stride]
        self._train_images = ImageCache(scratch / "train.npy", self._train, dataset.frames)
        self._validation_images = ImageCache(scratch / "validation.npy", self._validation, dataset.frames)
        self._others = OtherCameras(dataset.rig)
        self._objective = _objective(config)
        self._schedule = _schedule(config)
        self._optimizer = torch.optim.AdamW(network.parameters(), lr=1.0, weight_decay=_WEIGHT_DECAY)
        self._epochs: list[Epoch] = []
        self._best_step = 0
        self._best_state: dict[str, Tensor] = {}
        self._mixed = _has_bfloat16()

    # --- one epoch --------------------------------------------------------------------------
    def run_epoch(self, progress: Progress) -> None:
        """Train, validate, write a checkpoint."""
        config = self._config
        end = min(self.step + config.steps_per_epoch, config.steps)
        count = -(-config.steps // config.steps_per_epoch)
        number = len(self._epochs) + 1
        rate = self._schedule.rate(self.step)
        sums: dict[str, float] = {}
        first = self.step
        self._network.train()
        while self.step < end:
            parts = self._train_step()
            for name, value in parts.items():
                sums[name] = sums.get(name, 0.0) + value
            self.step += 1
            progress(self.step / config.steps, f"epoch {number} of {count}", loss=parts["total"])
        train = {name: value / (end - first) for name, value in sums.items()}
        validation = self._validate()
        self._epochs.append(Epoch(self.step, rate, train, validation))
        judged = validation.get("total", train["total"])
        self._schedule = self._schedule.after_epoch(judged)
        if judged <= min(_judged(epoch) for epoch in self._epochs):
            self._best_step = self.step
            self._best_state = {name: value.clone() for name, value in self._network.state_dict().items()}
        if validation:
            progress(self.step / config.steps, f"epoch {number} of {count}", validation_loss=validation["total"])
        self._write_checkpoint()

    def _train_step(self) -> dict[str, float]:
        numbers, rng = self._draw()
        views: list[LabelledView] = []
        mirrored: list[bool] = []
        for number in numbers:
            view = self._train_images.view(number)
            mirrored.append(bool(rng.random() < 0.5))
            if self._config.method == "lifted" and rng.random() < _SHAKEN_SHARE:
                view = shake(view, rng)
            view = mirror(view) if mirrored[-1] else view
            views.append(replace(view, image=jitter_colour(view.image, rng)))
        parts = self._losses(views, [self._train[number] for number in numbers], mirrored)
        total = parts["total"]
        if not math.isfinite(float(total.detach())):
            raise self._not_finite(numbers)
        for group in self._optimizer.param_groups:
            group["lr"] = self._schedule.rate(self.step)
        self._optimizer.zero_grad(set_to_none=True)
        total.backward()
        nn.utils.clip_grad_norm_(self._network.parameters(), _GRADIENT_CLIP)
        self._optimizer.step()
        return {name: float(part.detach()) for name, part in parts.items()}

    def _losses(
        self, views: list[LabelledView], sources: Sequence[SiteView], mirrored: Sequence[bool]
    ) -> dict[str, Tensor]:
        images = to_input(np.stack([view.image for view in views]))
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=self._mixed):
            outputs: SmallOutputs = self._network(images)
        others = self._others.of(sources, mirrored)
        return self._objective(outputs, encode(views), self._network.mean_sizes_m, others)

    def _draw(self) -> tuple[list[int], np.random.Generator]:
        """The numbers of this step's views, from a fresh shuffle every time all were seen, and its generator.

        Both depend on the seed and the step alone: nothing needs to be stored to resume.
        """
        size, total = self._config.batch_size, len(self._train)
        numbers: list[int] = []
        for place in range(self.step * size, (self.step + 1) * size):
            order = np.random.default_rng([self._config.seed, 0, place // total]).permutation(total)
            numbers.append(int(order[place % total]))
        return numbers, np.random.default_rng([self._config.seed, 1, self.step])

    def _not_finite(self, numbers: Sequence[int]) -> NonFiniteLoss:
        frames = [(self._train[number].camera_id, self._train[number].time_ns) for number in numbers]
        named = ", ".join(f"{camera_id} at {time_ns * 1e-9:.2f} s" for camera_id, time_ns in frames)
        return NonFiniteLoss(
            f"the loss is not finite at step {self.step}; the batch holds {named}",
            step=self.step,
            frames=[{"camera_id": camera_id, "time_ns": time_ns} for camera_id, time_ns in frames],
        )

    def _validate(self) -> dict[str, float]:
        self._network.eval()
        sums: dict[str, float] = {}
        size = self._config.batch_size
        starts = range(0, len(self._validation), size)
        for start in starts:
            sources = self._validation[start : start + size]
            views = [self._validation_images.view(start + offset) for offset in range(len(sources))]
            with torch.inference_mode():
                parts = self._losses(views, sources, [False] * len(sources))
            for name, part in parts.items():
                sums[name] = sums.get(name, 0.0) + float(part) * len(sources)
        return {name: value / len(self._validation) for name, value in sums.items()}

    # --- checkpoints ------------------------------------------------------------------------
    @property
    def _checkpoint(self) -> Path:
        return self._scratch / "checkpoint.pt"

    def _write_checkpoint(self) -> None:
        state: dict[str, Any] = {
            "config": self._config.model_dump(),
            "step": self.step,
            "network": self._network.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "schedule": asdict(self._schedule),
            "epochs": [asdict(epoch) for epoch in self._epochs],
            "best_step": self._best_step,
            "best": self._best_state,
        }
        write_checkpoint(self._checkpoint, state)

    def resume(self) -> None:
        """Go on from the checkpoint, where there is one of the same options."""
        state = read_checkpoint(self._checkpoint)
        if state is None or state["config"] != self._config.model_dump():
            return
        self._network.load_state_dict(state["network"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._schedule = type(self._schedule)(**state["schedule"])
        self._epochs = [Epoch(**epoch) for epoch in state["epochs"]]
        self._best_step, self._best_state = state["best_step"], state["best"]
        self.step = state["step"]

    def result(self) -> FinetuneResult:
        """The last weights, or the best where validation says that the last are worse."""
        last, best = _judged(self._epochs[-1]), min(_judged(epoch) for epoch in self._epochs)
        worse = bool(self._epochs[-1].validation) and last > best + _TOLERATED_RISE * abs(best)
        if worse:
            self._network.load_state_dict(self._best_state)
        return FinetuneResult(
            self._network.eval(),
            tuple(self._epochs),
            "best" if worse else "last",
            self._best_step if worse else self.step,
        )


def _judged(epoch: Epoch) -> float:
    return epoch.validation.get("total", epoch.train["total"])


def _has_bfloat16() -> bool:
    """Whether the processor multiplies in bfloat16; without, mixed precision is slower than float32."""
    return bool(torch.cpu.get_capabilities().get("avx512_bf16", False))
