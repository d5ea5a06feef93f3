"""The small network in ONNX Runtime, which runs it on a CPU faster than torch does."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray
from torch import Tensor

from wibam_core.documents.model_card import ModelCard
from wibam_core.errors import InvalidWeights
from wibam_core.formats.model_card import card_of
from wibam_core.models.classes import ClassChannels
from wibam_core.models.frames import INPUT_WIDTH_PX, Frame, to_input
from wibam_core.models.onnx_session import open_session
from wibam_core.networks.small.architecture import SmallOutputs
from wibam_core.networks.small.export import OUTPUT_FACTS, channels
from wibam_core.networks.small.predict import Maps, predict_each
from wibam_core.placing import Decode
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Vehicles3D

#: What weights files and ONNX files call the small network.
FAMILY_NAME = "wibam-small"
#: How its boxes can be placed.
DECODES: tuple[Decode, ...] = ("plane", "depth", "fused", "ground", "fitted", "refined")

_EXPECTED = "Give the ONNX file of a fine-tuned model as it was exported, or its safetensors file."


class OnnxNetwork:
    """Detects on the CPU what `SmallNetwork` does in evaluation mode.

    Args:
        session: an ONNX file as `wibam_core.networks.small.export.small_onnx` makes it.
        source: what an error calls it.

    Attributes:
        card: what the file says.
        mean_sizes_m: (C, 3) mean length, width, height per class, float32.

    Raises:
        InvalidWeights: it is another network.
    """

    card: ModelCard
    mean_sizes_m: Tensor

    def __init__(self, session: onnxruntime.InferenceSession, source: str) -> None:
        self._session = session
        metadata = session.get_modelmeta().custom_metadata_map
        _check_metadata(source, metadata)
        self.card = card_of(source, metadata, DECODES)
        self._classes = ClassChannels.of(source, self.card.classes)
        self._outputs = channels(len(self.card.classes))
        _check_ends(source, session, self._outputs)
        self.mean_sizes_m = _mean_sizes_m(source, metadata.get("mean_sizes_m", ""), len(self.card.classes))

    @classmethod
    def load(cls, path: Path, threads: int | None = None) -> OnnxNetwork:
        """The network in a file, on so many CPU threads within one pass; torch's own number where none is given."""
        return cls(open_session(path, path.name, threads=threads or torch.get_num_threads(), hint=_EXPECTED), path.name)

    @classmethod
    def of(cls, content: bytes, threads: int | None = None) -> OnnxNetwork:
        """The network of a file's content; threads as in `load`."""
        source = "the exported network"
        return cls(open_session(content, source, threads=threads or torch.get_num_threads(), hint=_EXPECTED), source)

    @property
    def known(self) -> frozenset[RoadUserClass]:
        """What it tells apart."""
        return self._classes.known

    def predict_each(
        self, frames: Iterable[Frame], *, decodes: Sequence[Decode], min_score: float, batch_size: int = 8
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        """See `wibam_core.models.network.Network`; so many images a pass."""
        maps = Maps(self._run, self.mean_sizes_m, self._classes.numbers, self.card.input_width_px or INPUT_WIDTH_PX)
        return predict_each(maps, frames, decodes=decodes, min_score=min_score, batch_size=batch_size)

    def _run(self, images: NDArray[np.uint8]) -> SmallOutputs:
        return self(to_input(images, layout=torch.contiguous_format))

    def __call__(self, images: Tensor) -> SmallOutputs:
        """The maps of images (B, 3, H, W), BGR in 0..1."""
        found = self._session.run(list(self._outputs), {"image": np.ascontiguousarray(images.numpy())})
        return SmallOutputs(**dict(zip(self._outputs, map(torch.from_numpy, found), strict=True)))


def _check_metadata(source: str, found: Mapping[str, str]) -> None:
    for key, value in {"family": FAMILY_NAME, **OUTPUT_FACTS}.items():
        if found.get(key) != value:
            raise InvalidWeights(f"{source}: {key} is {found.get(key)!r}, not {value!r}", hint=_EXPECTED, field=key)


def _check_ends(source: str, session: onnxruntime.InferenceSession, outputs: Mapping[str, int]) -> None:
    """There are the input and the outputs that there should be, of float32, with their numbers of channels."""
    found = {node.name: (node.type, node.shape[1:2]) for node in (*session.get_inputs(), *session.get_outputs())}
    for name, count in {"image": 3, **outputs}.items():
        if found.get(name) != ("tensor(float)", [count]):
            raise InvalidWeights(
                f"{source} has no input or output {name} of float32 with {count} channels", hint=_EXPECTED, field=name
            )


def _mean_sizes_m(source: str, text: str, classes: int) -> Tensor:
    try:
        sizes_m = torch.tensor(json.loads(text), dtype=torch.float32)
    except (ValueError, TypeError, RuntimeError):
        sizes_m = torch.empty(0)
    if sizes_m.shape != (classes, 3) or not bool((sizes_m.isfinite() & (sizes_m > 0)).all()):
        raise InvalidWeights(
            f"{source}: mean_sizes_m is {text!r}, not a length, width and height in m for each class",
            hint=_EXPECTED,
            field="mean_sizes_m",
        )
    return sizes_m
