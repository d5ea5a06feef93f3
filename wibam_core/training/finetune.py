"""Fine-tune a network on a site's multi-view boxes. Seeded, and resumable to the bit on one machine."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn

from wibam_core.config import FinetuneConfig
from wibam_core.documents.curves import Epoch
from wibam_core.errors import NoMultiViewVehicles, NonFiniteLoss, StageOutOfMemory, TooFewInstants
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.camera import Camera
from wibam_core.progress import Progress, silent
from wibam_core.scene import CameraRig
from wibam_core.training.batches import Batch, Batches
from wibam_core.training.checkpoint import read_checkpoint, write_checkpoint
from wibam_core.training.dataset import SiteView, input_width_of
from wibam_core.training.device import Precision, choose_device
from wibam_core.training.distributed import Ranks, helpers, usable_devices
from wibam_core.training.multiview import OtherCameras
from wibam_core.training.schedule import CosineSchedule, LearningRateSchedule, PlateauSchedule
from wibam_core.training.trainable import TrainableNetwork

_GRADIENT_CLIP = 5.0
_WEIGHT_DECAY = 1e-3

#: Validation looks at this many views at most, evenly spread.
_MAX_VALIDATION_VIEWS = 96

#: The last weights are kept unless their validation loss is worse than the best by more than this share.
_TOLERATED_RISE = 0.03

#: The share of a batch that a process has that runs the network on all of it.
_WHOLE = slice(None)


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

    @property
    def input_width_px(self) -> int:
        """How wide the network sees the images."""
        return input_width_of(itertools.chain(self.train, self.validation))


@dataclass(frozen=True, eq=False)
class FinetuneResult:
    """What a training ends with.

    Attributes:
        network: fine-tuned, on the CPU in evaluation mode; its card is still what it began with.
        epochs: losses of all.
        kept, kept_step: which weights.
    """

    network: TrainableNetwork
    epochs: tuple[Epoch, ...]
    kept: Literal["last", "best"]
    kept_step: int


def finetune(
    network: TrainableNetwork, dataset: SiteDataset, config: FinetuneConfig, progress: Progress, scratch: Path
) -> FinetuneResult:
    """Train ``network`` in place and return it.

    Args:
        network: where to start from.
        dataset: labelled frames.
        config: method, decoding, steps, batch size, learning rate, device, seed.
        progress: told after every step.
        scratch: keeps a checkpoint after every epoch; training goes on from there, equal to the bit.

    Raises:
        InvalidOption: the options name a device that is not there.
        TooFewInstants: there is no frame to train on.
        NoMultiViewVehicles: no frame has a vehicle that teaches 3D.
        NonFiniteLoss: naming the step and the frames.
        StageOutOfMemory: on a GPU.
    """
    precision = Precision.of(choose_device(config.device))
    devices = usable_devices(precision.device, config.batch_size)
    try:
        return finetune_on(devices, precision, network, dataset, config, progress, scratch)
    except torch.OutOfMemoryError as error:  # of a GPU
        raise StageOutOfMemory("the GPU has too little memory for this network and batch size") from error


def finetune_on(
    devices: int,
    precision: Precision,
    network: TrainableNetwork,
    dataset: SiteDataset,
    config: FinetuneConfig,
    progress: Progress,
    scratch: Path,
) -> FinetuneResult:
    """As `finetune`, by so many processes with a device each; the batch size is a multiple of their number."""
    _check(dataset, config)
    scratch.mkdir(parents=True, exist_ok=True)
    if devices == 1:
        alone = Ranks(0, 1, precision.device)
        result = _trained(_Training(network, dataset, config, scratch, precision, alone), progress)
        network.module.cpu()
        return result
    structure = copy.deepcopy(network)
    structure.module.to("meta")  # the weights go to the helpers by themselves
    arguments = (structure, dataset.frames, dict(dataset.rig), dataset.train, config, scratch, precision)
    twin = copy.deepcopy(network)  # its batch normalisation becomes another
    with helpers(devices, precision.device, scratch / "rendezvous", _help_out, arguments) as ranks:
        result = _trained(_Training(twin, dataset, config, scratch, precision, ranks), progress)
    network.module.load_state_dict(result.network.module.state_dict())
    network.module.cpu().eval()
    return replace(result, network=network)


def _help_out(
    ranks: Ranks,
    network: TrainableNetwork,
    frames: FrameStore,
    cameras: dict[str, Camera],
    train: Sequence[SiteView],
    config: FinetuneConfig,
    scratch: Path,
    precision: Precision,
) -> None:
    dataset = SiteDataset(frames, CameraRig(cameras), train, [])
    network.module.to_empty(device=ranks.device)
    _trained(_Training(network, dataset, config, scratch, precision, ranks), silent)


def _trained(training: _Training, progress: Progress) -> FinetuneResult:
    training.resume()
    while not training.done:
        training.run_epoch(progress)
    return training.result()


def _check(dataset: SiteDataset, config: FinetuneConfig) -> None:
    if not dataset.train:
        raise TooFewInstants("the training part of the split has no frame")
    if config.method == "paper":
        taught = any(len(view.other_vehicle) for view in dataset.train)
    else:
        taught = any((view.pseudo_labels.confidence > 0).any() for view in dataset.train)
    if not taught:
        raise NoMultiViewVehicles("no vehicle in the training part of the split could be placed in 3D from two cameras")


def _schedule(config: FinetuneConfig, network: TrainableNetwork) -> LearningRateSchedule:
    rate = config.learning_rate or network.default_rates[config.method]
    return PlateauSchedule(rate) if config.method == "paper" else CosineSchedule(rate, config.steps)


class _Training:
    """The state of one fine-tuning between epochs, in one of its processes."""

    def __init__(
        self,
        network: TrainableNetwork,
        dataset: SiteDataset,
        config: FinetuneConfig,
        scratch: Path,
        precision: Precision,
        ranks: Ranks,
    ) -> None:
        self.step = 0
        self._config = config
        self._precision = replace(precision, device=ranks.device)
        self._ranks = ranks
        ranks.synchronise(network.module.to(ranks.device))
        self._network = network
        self._module = network.module.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._checkpoint = scratch / "checkpoint.pt"
        self._train = dataset.train
        stride = max(1, -(-len(dataset.validation) // _MAX_VALIDATION_VIEWS))
        self._validation = dataset.validation[::stride] if ranks.is_first else []
        own = scratch if ranks.is_first else scratch / f"helper{ranks.rank}"
        own.mkdir(exist_ok=True)
        self._batches = Batches(self._train, network.reader(own / "train.npy", self._train, dataset.frames), config)
        self._validation_batches = Batches(
            self._validation, network.reader(own / "validation.npy", self._validation, dataset.frames), config
        )
        self._others = OtherCameras(dataset.rig, config.own_view, dataset.input_width_px)
        self._schedule = _schedule(config, network)
        self._optimizer = torch.optim.AdamW(self._module.parameters(), lr=1.0, weight_decay=_WEIGHT_DECAY, fused=True)
        self._scaler = self._precision.scaler()
        self._epochs: list[Epoch] = []
        self._best_step = 0
        self._best_state: dict[str, Tensor] = {}

    @property
    def done(self) -> bool:
        """All steps are made."""
        return self.step >= self._config.steps

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
        self._module.train()
        while self.step < end:
            parts = self._train_step()
            for name, value in parts.items():
                sums[name] = sums.get(name, 0.0) + value
            self.step += 1
            progress(self.step / config.steps, f"epoch {number} of {count}", loss=parts["total"])
        train = {name: value / (end - first) for name, value in sums.items()}
        validation = self._validate()
        self._epochs.append(Epoch(step=self.step, learning_rate=rate, train=train, validation=validation))
        judged = self._ranks.from_first(_judged(self._epochs[-1]))
        self._schedule = self._schedule.after_epoch(judged)
        if not self._ranks.is_first:
            return
        if judged <= min(_judged(epoch) for epoch in self._epochs):
            self._best_step = self.step
            self._best_state = {name: value.clone() for name, value in self._module.state_dict().items()}
        if validation:
            progress(self.step / config.steps, f"epoch {number} of {count}", validation_loss=validation["total"])
        self._write_checkpoint()

    def _train_step(self) -> dict[str, float]:
        batch = self._batches.to_learn(self.step)
        parts = self._losses(batch, self._ranks.share(len(batch.views)))
        if not math.isfinite(float(parts["total"].detach())):
            raise self._not_finite(batch.sources)
        self._update(parts["total"])
        return {name: float(part.detach()) for name, part in parts.items()}

    def _update(self, loss: Tensor) -> None:
        for group in self._optimizer.param_groups:
            group["lr"] = self._schedule.rate(self.step)
        self._optimizer.zero_grad(set_to_none=True)
        self._scaler.scale(loss.to(self._precision.device)).backward()
        self._ranks.add_gradients(self._module.parameters())
        self._scaler.unscale_(self._optimizer)
        nn.utils.clip_grad_norm_(self._module.parameters(), _GRADIENT_CLIP)
        self._scaler.step(self._optimizer)
        self._scaler.update()

    def _losses(self, batch: Batch, share: slice) -> dict[str, Tensor]:
        """Of a batch of which this process runs the network on a ``share``, and the others on theirs."""
        with self._precision.autocast():
            own = self._network.maps(batch.views, share)
        maps = own if share == _WHOLE else self._ranks.gather(own)
        return self._network.losses(maps, batch.views, self._others.of(batch.sources, batch.mirrored), self._config)

    def _not_finite(self, views: Sequence[SiteView]) -> NonFiniteLoss:
        frames = [(view.camera_id, view.time_ns) for view in views]
        named = ", ".join(f"{camera_id} at {time_ns * 1e-9:.2f} s" for camera_id, time_ns in frames)
        return NonFiniteLoss(
            f"the loss is not finite at step {self.step}; the batch holds {named}",
            step=self.step,
            frames=[{"camera_id": camera_id, "time_ns": time_ns} for camera_id, time_ns in frames],
        )

    def _validate(self) -> dict[str, float]:
        self._module.eval()
        sums: dict[str, float] = {}
        size = self._config.batch_size
        starts = range(0, len(self._validation), size)
        for start in starts:
            batch = self._validation_batches.to_judge(start, start + size)
            with torch.inference_mode():
                parts = self._losses(batch, _WHOLE)
            if not math.isfinite(float(parts["total"])):
                raise self._not_finite(batch.sources)
            for name, part in parts.items():
                sums[name] = sums.get(name, 0.0) + float(part) * len(batch.sources)
        return {name: value / len(self._validation) for name, value in sums.items()}

    # --- checkpoints ------------------------------------------------------------------------
    def _write_checkpoint(self) -> None:
        state: dict[str, Any] = {
            "config": self._config.model_dump(),
            "step": self.step,
            "network": self._module.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "scaler": self._scaler.state_dict(),
            "schedule": asdict(self._schedule),
            "epochs": [epoch.model_dump() for epoch in self._epochs],
            "best_step": self._best_step,
            "best": self._best_state,
        }
        write_checkpoint(self._checkpoint, state)

    def resume(self) -> None:
        """Go on from the checkpoint, where there is one of the same options."""
        state = read_checkpoint(self._checkpoint)
        if state is None or state["config"] != self._config.model_dump():
            return
        self._module.load_state_dict(state["network"])
        self._optimizer.load_state_dict(state["optimizer"])
        if state["scaler"]:
            self._scaler.load_state_dict(state["scaler"])
        self._schedule = type(self._schedule)(**state["schedule"])
        self._epochs = [Epoch(**epoch) for epoch in state["epochs"]]
        self._best_step, self._best_state = state["best_step"], state["best"]
        self.step = state["step"]

    def result(self) -> FinetuneResult:
        """The last weights, or the best where validation says that the last are worse."""
        last, best = _judged(self._epochs[-1]), min(_judged(epoch) for epoch in self._epochs)
        worse = bool(self._epochs[-1].validation) and last > best + _TOLERATED_RISE * abs(best)
        if worse:
            self._module.load_state_dict(self._best_state)
        self._module.eval()
        return FinetuneResult(
            self._network,
            tuple(self._epochs),
            "best" if worse else "last",
            self._best_step if worse else self.step,
        )


def _judged(epoch: Epoch) -> float:
    return epoch.validation.get("total", epoch.train["total"])
