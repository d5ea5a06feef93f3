"""``clocks.json``: every camera's clock against the reference camera's.

.. code-block:: json

    {"format": "wibam-clocks", "version": 1, "clocks": [
        {"camera_id": "north", "offset_ns": 0, "drift": 0.0, "offset_sd_ns": 0.0, "drift_sd": 0.0}, ...]}

The first camera is the reference. Standard deviations are absent where they are unknown. Where segments of a recording
lie elsewhere than assumed, a clock also has ``"pieces": [{"from_ns": 8000000000, "shift_ns": 61250000000}, ...]``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pydantic
from pydantic import BaseModel, ConfigDict, Field

from wibam_core.clocks import ClockMap, ClockPiece
from wibam_core.errors import InputError


@dataclass(frozen=True)
class ClockError:
    """How well a `ClockMap` is known: standard deviations of its offset (ns, at the middle of the changes it was
    found from) and of its drift."""

    offset_sd_ns: float
    drift_sd: float


@dataclass(frozen=True, eq=False)
class Clocks(Mapping[str, ClockMap]):
    """Clock maps by camera id, the reference first.

    Attributes:
        maps: camera id -> its clock.
        errors: how well the clocks are known, where that is known.
    """

    maps: Mapping[str, ClockMap]
    errors: Mapping[str, ClockError] = field(default_factory=dict)

    def __getitem__(self, camera_id: str) -> ClockMap:
        return self.maps[camera_id]

    def __iter__(self) -> Iterator[str]:
        return iter(self.maps)

    def __len__(self) -> int:
        return len(self.maps)


class _Piece(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    from_ns: int
    shift_ns: int


class _Clock(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    camera_id: str = Field(min_length=1)
    offset_ns: int
    drift: float = Field(gt=-0.5, lt=0.5)
    offset_sd_ns: float | None = Field(None, ge=0)
    drift_sd: float | None = Field(None, ge=0)
    pieces: tuple[_Piece, ...] | None = None

    @pydantic.model_validator(mode="after")
    def _ascending_pieces(self) -> _Clock:
        self.map()
        return self

    def map(self) -> ClockMap:
        pieces = tuple(ClockPiece(piece.from_ns, piece.shift_ns) for piece in self.pieces or ())
        return ClockMap(self.offset_ns, self.drift, pieces)


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


def write_clocks(path: Path, clocks: Clocks) -> None:
    """Write clock maps, and how well they are known."""
    known = clocks.errors
    document = _Clocks(
        clocks=tuple(
            _Clock(
                camera_id=camera_id,
                offset_ns=int(clock.offset_ns),
                drift=float(clock.drift),
                offset_sd_ns=known[camera_id].offset_sd_ns if camera_id in known else None,
                drift_sd=known[camera_id].drift_sd if camera_id in known else None,
                pieces=tuple(_Piece(from_ns=p.from_ns, shift_ns=p.shift_ns) for p in clock.pieces) or None,
            )
            for camera_id, clock in clocks.items()
        )
    )
    path.write_text(document.model_dump_json(indent=1, exclude_none=True) + "\n", encoding="utf-8")


def read_clocks(path: Path) -> Clocks:
    """Read what `write_clocks` wrote.

    Raises:
        InputError: if the file is missing or malformed.
    """
    try:
        read = _Clocks.model_validate_json(path.read_bytes()).clocks
    except FileNotFoundError as error:
        raise InputError(f"{path.name} does not exist", hint="Run the sync stage first.") from error
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise InputError(
            f"{path.name} is no table of clocks: {where}: {first['msg']}", hint="Use the clocks.json of the sync stage."
        ) from error
    return Clocks(
        {clock.camera_id: clock.map() for clock in read},
        {
            clock.camera_id: ClockError(clock.offset_sd_ns, clock.drift_sd)
            for clock in read
            if clock.offset_sd_ns is not None and clock.drift_sd is not None
        },
    )
