"""Checkpoints of a training: written whole or not at all, read without running any code in them."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import torch


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Write tensors and plain types."""
    temporary = path.with_name(path.name + ".tmp")
    torch.save(state, temporary)
    temporary.replace(path)


def read_checkpoint(path: Path) -> dict[str, Any] | None:
    """What was written, on the CPU whatever device it was trained on.

    None where there is nothing or it cannot be read: training then starts anew.
    """
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
    except (FileNotFoundError, RuntimeError, EOFError, pickle.UnpicklingError):
        return None
    return state
