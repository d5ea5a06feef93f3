"""Networks of users are opened from what they hold alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from wibam_core.errors import InvalidWeights
from wibam_core.models.onnx_session import open_session


def network(weights: TensorProto, *, inner: bool) -> onnx.ModelProto:
    """x + weights; the weights are an initializer, or the value of a node of a branch."""
    x, y = (helper.make_tensor_value_info(name, TensorProto.FLOAT, [4]) for name in ("x", "y"))
    if not inner:
        graph = helper.make_graph([helper.make_node("Add", ["x", "w"], ["y"])], "g", [x], [y], [weights])
    else:
        constant = helper.make_node("Constant", [], ["w"], value=weights)
        out = helper.make_tensor_value_info("w", TensorProto.FLOAT, [4])
        branch = helper.make_graph([constant], "branch", [], [out])
        yes = numpy_helper.from_array(np.array(True), "yes")
        chosen = helper.make_node("If", ["yes"], ["c"], then_branch=branch, else_branch=branch)
        graph = helper.make_graph([chosen, helper.make_node("Add", ["x", "c"], ["y"])], "g", [x], [y], [yes])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def elsewhere(location: str) -> TensorProto:
    tensor = TensorProto(name="w", data_type=TensorProto.FLOAT, dims=[4], data_location=TensorProto.EXTERNAL)
    tensor.external_data.add(key="location", value=location)
    return tensor


@pytest.mark.parametrize("inner", [False, True])
@pytest.mark.parametrize("as_bytes", [False, True])
def test_values_in_another_file_are_never_read(tmp_path: Path, inner: bool, as_bytes: bool) -> None:
    (tmp_path / "secret").write_bytes(np.arange(4, dtype=np.float32).tobytes())
    path = tmp_path / "detector.onnx"
    path.write_bytes(network(elsewhere("secret"), inner=inner).SerializeToString())
    with pytest.raises(InvalidWeights, match="'w' in another file") as refused:
        open_session(path.read_bytes() if as_bytes else path, path.name, threads=1, hint="-")
    assert "one file" in refused.value.hint


@pytest.mark.parametrize("inner", [False, True])
def test_values_of_its_own_are_run(tmp_path: Path, inner: bool) -> None:
    path = tmp_path / "detector.onnx"
    weights = numpy_helper.from_array(np.arange(4, dtype=np.float32), "w")
    path.write_bytes(network(weights, inner=inner).SerializeToString())
    session = open_session(path, path.name, threads=1, hint="-")
    [y] = session.run(None, {"x": np.ones(4, np.float32)})
    assert y.tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize("content", [b"", b"not a network", b"\x08\x07"])
def test_what_is_no_network_is_said_to_be_none(content: bytes) -> None:
    with pytest.raises(InvalidWeights):
        open_session(content, "detector.onnx", threads=1, hint="-")
