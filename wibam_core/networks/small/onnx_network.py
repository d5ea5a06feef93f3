"""The small network in ONNX Runtime, which runs it on a CPU faster than torch does."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime
import torch
from torch import Tensor

from wibam_core.errors import InvalidWeights
from wibam_core.models.usage import SMALL_DECODES, Usage, read_input_width
from wibam_core.networks.small.architecture import SmallNetwork, SmallOutputs
from wibam_core.networks.small.export import SMALL_CHANNELS, small_metadata, small_onnx
from wibam_core.road_users import CLASSES

_EXPECTED = "Give the ONNX file of a fine-tuned model as it was exported, or its safetensors file."


class OnnxNetwork:
    """Computes on the CPU what `SmallNetwork` does in evaluation mode: (B, 3, H, W), BGR in 0..1, to `SmallOutputs`.

    The same file on the same number of threads gives the same values each time.

    Args:
        content: an ONNX file as `wibam_core.models.export.small_onnx` makes it.
        source: what an error calls it.
        threads: CPU threads within one pass; torch's own number where none is given.

    Attributes:
        mean_sizes_m: (4, 3) mean length, width, height per class, float32.
        input_width_px: width that images are resized to before it sees them.
        usage: how the file says that it is to be used.

    Raises:
        InvalidWeights: it cannot be run, or is another network.
    """

    mean_sizes_m: Tensor
    input_width_px: int
    usage: Usage

    def __init__(self, content: bytes, source: str, threads: int | None = None) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads or torch.get_num_threads()
        options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # each kind of defect has its own class in onnxruntime, all directly below Exception
            said = (str(error).strip().splitlines() or [type(error).__name__])[0]
            raise InvalidWeights(f"{source} is no ONNX network that can be run: {said}", hint=_EXPECTED) from error
        metadata = self._session.get_modelmeta().custom_metadata_map
        _check_metadata(source, metadata)
        _check_ends(source, self._session)
        self.mean_sizes_m = _mean_sizes_m(source, metadata.get("mean_sizes_m", ""))
        self.input_width_px = read_input_width(source, metadata)
        self.usage = Usage.of(source, metadata, SMALL_DECODES)

    @classmethod
    def load(cls, path: Path, threads: int | None = None) -> OnnxNetwork:
        """The network in a file; the arguments and errors are the class's."""
        if not path.is_file():
            raise InvalidWeights(f"{path} does not exist", hint=_EXPECTED)
        return cls(path.read_bytes(), path.name, threads)

    @classmethod
    def of(cls, network: SmallNetwork, threads: int | None = None) -> OnnxNetwork:
        """A network of torch's, as it is now; it says nothing of its usage."""
        return cls(small_onnx(network), "the exported network", threads)

    def __call__(self, images: Tensor) -> SmallOutputs:
        maps = self._session.run(list(SMALL_CHANNELS), {"image": np.ascontiguousarray(images.numpy())})
        return SmallOutputs(**dict(zip(SMALL_CHANNELS, map(torch.from_numpy, maps), strict=True)))


def _check_metadata(source: str, found: dict[str, str]) -> None:
    for key, value in small_metadata().items():
        if found.get(key) != value:
            raise InvalidWeights(f"{source}: {key} is {found.get(key)!r}, not {value!r}", hint=_EXPECTED, field=key)


def _check_ends(source: str, session: onnxruntime.InferenceSession) -> None:
    """There are the input and the outputs that there should be, of float32, with their numbers of channels."""
    found = {node.name: (node.type, node.shape[1:2]) for node in (*session.get_inputs(), *session.get_outputs())}
    for name, channels in {"image": 3, **SMALL_CHANNELS}.items():
        if found.get(name) != ("tensor(float)", [channels]):
            raise InvalidWeights(
                f"{source} has no input or output {name} of float32 with {channels} channels",
                hint=_EXPECTED,
                field=name,
            )


def _mean_sizes_m(source: str, text: str) -> Tensor:
    try:
        sizes_m = torch.tensor(json.loads(text), dtype=torch.float32)
    except (ValueError, TypeError, RuntimeError):
        sizes_m = torch.empty(0)
    if sizes_m.shape != (len(CLASSES), 3) or not bool((sizes_m.isfinite() & (sizes_m > 0)).all()):
        raise InvalidWeights(
            f"{source}: mean_sizes_m is {text!r}, not a length, width and height in m for each class",
            hint=_EXPECTED,
            field="mean_sizes_m",
        )
    return sizes_m
