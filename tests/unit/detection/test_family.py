"""What a card says is what a network is given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper

from wibam_core.detection.detector import FAMILIES
from wibam_core.detection.yolox import CARD

IMAGE = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def echo(tmp_path_factory: pytest.TempPathFactory) -> onnxruntime.InferenceSession:
    """A network that gives back what it is given."""
    path: Path = tmp_path_factory.mktemp("echo") / "echo.onnx"
    inputs, outputs = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 3, 4, 6]) for name in ("x", "y"))
    graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "echo", [inputs], [outputs])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9), str(path))
    return onnxruntime.InferenceSession(str(path))


@pytest.mark.parametrize(("channels", "order"), [("BGR", [0, 1, 2]), ("RGB", [2, 1, 0])])
@pytest.mark.parametrize("highest", [1.0, 255.0])
def test_colours_and_range_are_the_cards(
    echo: onnxruntime.InferenceSession, channels: str, order: list[int], highest: float
) -> None:
    (seen,) = replace(CARD, channels=channels, highest=highest).run(echo, IMAGE)
    np.testing.assert_allclose(seen[0], IMAGE[..., order].transpose(2, 0, 1) * (highest / 255), rtol=1e-6)


def test_what_is_missing_is_named(echo: onnxruntime.InferenceSession) -> None:
    assert CARD.missing(echo) == []
    assert replace(CARD, input_name="image", outputs=("heat", "y")).missing(echo) == ["heat", "image"]
    assert replace(CARD, input_type="tensor(float16)").missing(echo) == ["x"]


def test_every_family_has_a_card_of_its_own() -> None:
    assert len({family.card.name for family in FAMILIES}) == len(FAMILIES)
