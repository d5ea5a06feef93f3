"""What a family of 3D networks declares: which files are its own, and what its networks can be asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import onnxruntime

from wibam_core.config import FinetuneConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.errors import InvalidOption
from wibam_core.models.network import Network
from wibam_core.placing import NEEDS, Decode
from wibam_core.training.trainable import TrainableNetwork


@dataclass(frozen=True)
class Family:
    """Networks that differ in their weights, classes and input alone.

    Attributes:
        name: as weights files say it.
        decodes: how their boxes can be placed; first what a file means that does not say.
        methods: how they can be fine-tuned.
        load: a network, on the CPU in evaluation mode, of a weights file and what that says; raises `InvalidWeights`.
        load_onnx: the same of an ONNX file and its name, to detect with; None: there are no such files.
        own_input: what images they see, where that cannot be chosen; it follows "sees".
        advice: for whoever runs one over a recording.
    """

    name: str
    decodes: tuple[Decode, ...]
    methods: tuple[str, ...]
    load: Callable[[Path, ModelCard], TrainableNetwork]
    load_onnx: Callable[[onnxruntime.InferenceSession, str], Network] | None = None
    own_input: str | None = None
    advice: str | None = None

    def check(self, config: FinetuneConfig) -> None:
        """Refuse options of fine-tuning that these networks have no use for.

        Raises:
            InvalidOption: naming the first.
        """
        if config.method not in self.methods:
            raise _refusal(config, "method", f"cannot be trained by it, only by {_all_of(self.methods)}")
        if config.decode not in self.decodes:
            lacks = NEEDS.get(config.decode, "such way")
            raise _refusal(config, "decode", f"has no {lacks}, only {_all_of(self.decodes)} are possible")
        if config.input_width_px is not None and self.own_input is not None:
            raise _refusal(config, "input_width_px", f"sees {self.own_input}")


def _refusal(config: FinetuneConfig, option: str, why: str) -> InvalidOption:
    name = f"finetune.{option}"
    return InvalidOption(f"option {name}: network '{config.network}' {why}", option=name)


def _all_of(names: Iterable[str]) -> str:
    return " and ".join(map(repr, sorted(names, reverse=True)))
