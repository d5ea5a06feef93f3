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
        InvalidWeights: it does not exist, or cannot be run.
    """
    if isinstance(content, Path) and not content.is_file():
        raise InvalidWeights(f"{source} does not exist", hint=hint)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    given = str(content) if isinstance(content, Path) else content
    try:
        return onnxruntime.InferenceSession(given, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # each kind of defect has its own class in onnxruntime, all directly below Exception
        said = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise InvalidWeights(f"{source} is no ONNX network that can be run: {said}", hint=hint) from error
