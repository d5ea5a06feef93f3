"""Tiny real recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wibam_core.video.encode import VideoWriter


def write_recording(
    path: Path, *, seconds: float = 2.0, fps: float = 10.0, width_px: int = 64, height_px: int = 48
) -> Path:
    """An H.264 recording of moving noise."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (height_px, width_px, 3), dtype=np.uint8)
    with VideoWriter(path, width_px, height_px, fps) as writer:
        for n in range(round(seconds * fps)):
            writer.write(np.roll(noise, n, axis=1), round(n * 1e9 / fps))
    return path
