"""Whether the disk holds what a stage is writing: known long before it is full."""

from __future__ import annotations

import shutil
from pathlib import Path

from wibam_core.errors import DiskFull

#: What is kept free for the stages after: weights, checkpoints, tables and the report.
_KEPT_BYTES = 200_000_000


def check_space(folder: Path, written_bytes: int, share: float) -> int:
    """How many bytes there will be in all, by what was written so far.

    Args:
        folder: on the disk that is written to.
        written_bytes: so far.
        share: of the work that is done, more than 0 and at most 1.

    Raises:
        DiskFull: the rest will not fit.
    """
    expected = round(written_bytes / share)
    free = shutil.disk_usage(folder).free
    missing = expected - written_bytes + _KEPT_BYTES - free
    if share < 1 and missing > 0:
        raise DiskFull(
            f"the frames will take {expected / 1e9:.2f} GB, of which {written_bytes / 1e9:.2f} GB are written, and "
            f"the disk has {free / 1e9:.2f} GB left",
            hint=f"Free {missing / 1e9:.2f} GB on the disk of the outputs, or lower frames.rate_hz, frames.width_px or "
            "frames.jpeg_quality.",
            expected_bytes=expected,
            free_bytes=free,
        )
    return expected
