"""Networks in ONNX Runtime."""

from __future__ import annotations

from pathlib import Path

import onnxruntime

from wibam_core.errors import InvalidWeights


def open_session(content: Path | bytes, source: str, *, threads: int, hint: str) -> onnxruntime.InferenceSession:
    """An ONNX file, ready to run on the CPU. On the same number of threads it gives the same values each time.

    Args:
        content: the file, or what it holds.
        source: what an error calls it.
        threads: CPU threads within one pass.
        hint: of the error.

    Raises:
        InvalidWeights: it does not exist, cannot be run, or names another file for its values: a user's network could
            name somebody else's file.
    """
    if isinstance(content, Path) and not content.is_file():
        raise InvalidWeights(f"{source} does not exist", hint=hint)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # threads that wait for the next pass would keep their cores busy, which others need in between
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4
    given = content.read_bytes() if isinstance(content, Path) else content
    if (elsewhere := _data_elsewhere(given)) is not None:
        raise InvalidWeights(
            f"{source} keeps the values of {elsewhere!r} in another file, which is never opened",
            hint="Save it as one file: onnx.save(onnx.load(FILE), FILE).",
        )
    try:
        return onnxruntime.InferenceSession(given, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # each kind of defect has its own class in onnxruntime, all directly below Exception
        said = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise InvalidWeights(f"{source} is no ONNX network that can be run: {said}", hint=hint) from error


def _data_elsewhere(content: bytes) -> str | None:
    """Name of a tensor of an ONNX file whose values lie in another file; None where there is none.

    Content that is no ONNX file has no tensors; ONNX Runtime says what is wrong with it.
    """
    import onnx  # takes longer to import than all else here, and hardly any program opens a network

    try:
        model = onnx.load_model_from_string(content)
    except Exception:  # protobuf's own, directly below it
        return None
    left: list[onnx.GraphProto | onnx.FunctionProto] = [model.graph, *model.functions]
    while left:
        graph = left.pop()
        tensors = list(graph.initializer) if isinstance(graph, onnx.GraphProto) else []
        if isinstance(graph, onnx.GraphProto):
            tensors += [part for sparse in graph.sparse_initializer for part in (sparse.values, sparse.indices)]
        for attribute in (one for node in graph.node for one in node.attribute):
            tensors += [attribute.t, *attribute.tensors]
            left += [attribute.g, *attribute.graphs]
        for tensor in tensors:
            if tensor.data_location == onnx.TensorProto.EXTERNAL:
                return str(tensor.name)
    return None
