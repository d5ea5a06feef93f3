"""A detector of a site's own that cannot be used is refused by the first stage, before anything is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import onnx
import pytest
from onnx import TensorProto, helper

from tests.builders import site_of
from wibam_core.config import PipelineConfig
from wibam_core.errors import InvalidWeights, UnreadableVideo
from wibam_core.stages.graph import InputDigests, plan
from wibam_core.stages.runner import SiteFolder, run_pipeline
from wibam_core.stages.store import StageStore
from wibam_core.video.recording import Recording

CUSTOM = PipelineConfig.parse({"detect": {"detector": "custom"}})


def _yolox(path: Path, divisor: int) -> None:
    """The input and output of the YOLOX family at 32x32 px (21 cells): the picture's values, of which only those that a
    fixed number divides could be arranged as it says.
    """
    output = helper.make_tensor_value_info("output", TensorProto.FLOAT, [1, 21, 85])
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, 32, 32])
    shape = helper.make_tensor("shape", TensorProto.INT64, [3], [1, 21, 85])
    start = helper.make_tensor("start", TensorProto.INT64, [1], [0])
    end = helper.make_tensor("end", TensorProto.INT64, [1], [divisor])
    flat = helper.make_tensor("flat", TensorProto.INT64, [1], [-1])
    nodes = [
        helper.make_node("Reshape", ["images", "flat"], ["values"]),
        helper.make_node("Slice", ["values", "start", "end"], ["some"]),
        helper.make_node("Reshape", ["some", "shape"], ["output"]),
    ]
    graph = helper.make_graph(nodes, "g", [image], [output], [shape, start, end, flat])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 8
    onnx.save(model, str(path))


def _text(path: Path) -> None:
    path.write_bytes(b"no network")


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (_text, "the site's detector: detector.onnx is no ONNX network that can be run"),
        (lambda path: _yolox(path, 1784), "the site's detector: detector.onnx "),  # one value too few to arrange
    ],
)
def test_is_refused_by_the_first_stage_where_it_is_used(
    tmp_path: Path, make: Callable[[Path], None], said: str
) -> None:
    (tmp_path / "video").write_bytes(b"no video")
    make(tmp_path / "detector.onnx")
    recordings = dict.fromkeys(site_of().camera_ids, Recording.at(tmp_path / "video"))
    folder = SiteFolder(site_of(), recordings, {"detector": tmp_path / "detector.onnx"})
    with pytest.raises(InvalidWeights, match=said):
        run_pipeline(folder, StageStore(tmp_path / "store"), CUSTOM)
    with pytest.raises(UnreadableVideo):  # nothing reads it
        run_pipeline(folder, StageStore(tmp_path / "store"), PipelineConfig())


def test_one_that_can_is_not_refused(tmp_path: Path) -> None:
    (tmp_path / "video").write_bytes(b"no video")
    _yolox(tmp_path / "detector.onnx", 1785)
    recordings = dict.fromkeys(site_of().camera_ids, Recording.at(tmp_path / "video"))
    folder = SiteFolder(site_of(), recordings, {"detector": tmp_path / "detector.onnx"})
    with pytest.raises(UnreadableVideo):
        run_pipeline(folder, StageStore(tmp_path / "store"), CUSTOM)


def test_another_one_is_checked_again_but_reads_no_recording_again() -> None:
    def hashes(digest: str) -> dict[str, str]:
        inputs = InputDigests(dict.fromkeys(site_of().camera_ids, "a"), {"detector": digest})
        return {stage.name: stage.hash for stage in plan(site_of(), CUSTOM, inputs)}

    one, other = hashes("b"), hashes("c")
    changed = {name for name, address in other.items() if address != one[name]}
    assert {"preflight", "detect"} <= changed
    assert changed.isdisjoint({"calibrate", "frames"})
