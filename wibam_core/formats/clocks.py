"""``clocks.json``: every camera's clock against the reference camera's.

.. code-block:: json

    {"format": "wibam-clocks", "version": 1, "clocks": [
        {"camera_id": "north", "offset_ns": 0, "drift": 0.0, "offset_sd_ns": 0.0, "drift_sd": 0.0}, ...]}

The first camera is the reference. Standard deviations are absent where they are unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pydantic
from pydantic import BaseModel, ConfigDict, Field

from wibam_core.errors import InputError
from wibam_core.scene import ClockMap


@dataclass(frozen=True)
class ClockError:
    """How well a `ClockMap` is known: standard deviations of its offset (ns, at the middle of the changes it was
    found from) and of its drift."""

    offset_sd_ns: float
    drift_sd: float


class _Clock(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    camera_id: str = Field(min_length=1)
    offset_ns: int
    drift: float = Field(gt=-0.5, lt=0.5)
    offset_sd_ns: float | None = Field(None, ge=0)
    drift_sd: float | None = Field(None, ge=0)


class _Clocks(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["wibam-clocks"] = "wibam-clocks"
    version: Literal[1] = 1
    clocks: tuple[_Clock, ...] = Field(min_length=1)

    @pydantic.model_validator(mode="after")
    def _unique_ids(self) -> _Clocks:
        ids = [clock.camera_id for clock in self.clocks]
        if len(set(ids)) != len(ids):
            raise ValueError(f"camera ids must differ: {ids}")
        return self


def write_clocks(path: Path, clocks: Mapping[str, ClockMap], errors: Mapping[str, ClockError] | None = None) -> None:
    """Write clock maps by camera id, the reference first, and how well they are known where ``errors`` says so."""
    known = errors or {}
    document = _Clocks(
        clocks=tuple(
            _Clock(
                camera_id=camera_id,
                offset_ns=int(clock.offset_ns),
                drift=float(clock.drift),
                offset_sd_ns=known[camera_id].offset_sd_ns if camera_id in known else None,
                drift_sd=known[camera_id].drift_sd if camera_id in known else None,
            )
            for camera_id, clock in clocks.items()
        )
    )
    path.write_text(document.model_dump_json(indent=1, exclude_none=True) + "\n", encoding="utf-8")


def _read(path: Path) -> _Clocks:
    try:
        return _Clocks.model_validate_json(path.read_bytes())
    except FileNotFoundError as error:
        raise InputError(f"{path.name} does not exist", hint="Run the sync stage first.") from error
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise InputError(
            f"{path.name} is no table of clocks: {where}: {first['msg']}", hint="Use the clocks.json of the sync stage."
        ) from error


def read_clocks(path: Path) -> dict[str, ClockMap]:
    """Clock maps by camera id, in the order of the file: the reference first.

    Raises:
        InputError: if the file is missing or malformed.
    """
    return {clock.camera_id: ClockMap(clock.offset_ns, clock.drift) for clock in _read(path).clocks}


def read_clock_errors(path: Path) -> dict[str, ClockError]:
    """How well the clocks are known, for the cameras where the file says so.

    Raises:
        InputError: if the file is missing or malformed.
    """
    return {
        clock.camera_id: ClockError(clock.offset_sd_ns, clock.drift_sd)
        for clock in _read(path).clocks
        if clock.offset_sd_ns is not None and clock.drift_sd is not None
    }
