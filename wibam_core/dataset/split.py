"""The split in time: three contiguous parts with gaps between them, and no vehicle in two of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from wibam_core.config import DatasetConfig
from wibam_core.errors import TooFewInstants
from wibam_core.scene import AnnotatedInstant, IntArray, MultiViewVehicle

SUBSETS = ("train", "val", "test")

#: A subset with fewer instants than this cannot say anything.
MIN_INSTANTS = 4
#: Gaps that take more than this share of the footage are worth a word.
_LARGE_GAPS = 0.2


@dataclass(frozen=True, eq=False)
class Split:
    """Which instants belong to which subset.

    Attributes:
        times_ns: subset -> instants in order of time, at the rate of the dataset.
        left_out_tracks: subset -> vehicles that a later subset sees too. They are no labels in this subset: the later
            one keeps them, so that the test subset loses none.
    """

    times_ns: Mapping[str, tuple[int, ...]]
    left_out_tracks: Mapping[str, frozenset[int]]

    def __post_init__(self) -> None:
        times = [set(self.times_ns[name]) for name in SUBSETS]
        if sum(map(len, times)) != len(set().union(*times)):
            raise ValueError("an instant belongs to two subsets")
        object.__setattr__(self, "times_ns", MappingProxyType(dict(self.times_ns)))
        object.__setattr__(self, "left_out_tracks", MappingProxyType(dict(self.left_out_tracks)))

    def subset_of(self) -> dict[int, str]:
        """Subset of every instant that is in one, by time."""
        return {time: name for name in SUBSETS for time in self.times_ns[name]}

    def labels(self, subset: str, instant: AnnotatedInstant) -> tuple[MultiViewVehicle, ...]:
        """The vehicles of an instant that may be labels in ``subset``."""
        left_out = self.left_out_tracks[subset]
        return tuple(vehicle for vehicle in instant.vehicles if vehicle.track_id not in left_out)

    def to_json(self) -> dict[str, object]:
        """``{"train": [time_ns, ...], "val": ..., "test": ..., "left_out_tracks": {"train": [...], ...}}``."""
        times: dict[str, object] = {name: list(self.times_ns[name]) for name in SUBSETS}
        return times | {"left_out_tracks": {name: sorted(self.left_out_tracks[name]) for name in SUBSETS}}

    @classmethod
    def from_json(cls, document: Mapping[str, object]) -> Split:
        """The inverse of `to_json`."""
        left_out = document["left_out_tracks"]
        assert isinstance(left_out, Mapping)
        times: dict[str, tuple[int, ...]] = {}
        for name in SUBSETS:
            listed = document[name]
            assert isinstance(listed, Sequence)
            times[name] = tuple(int(time) for time in listed)
        return cls(times, {name: frozenset(int(track) for track in left_out[name]) for name in SUBSETS})


def split_in_time(instants: Sequence[AnnotatedInstant], config: DatasetConfig) -> Split:
    """Split instants into train, val and test, in this order in time.

    The time from the first instant to the end of the last one, less the gaps, is shared out; instants in a gap belong
    to no subset. A vehicle that is still there after a gap, e.g. at a red light, is left out of the earlier subset.

    Args:
        instants: associated, in order of time.
        config: rate, shares and gap.

    Raises:
        TooFewInstants: a subset would have fewer than `MIN_INSTANTS` instants; says how much longer to record.
    """
    times = np.array([instant.time_ns for instant in instants], dtype=np.int64)
    chosen = at_rate(times, config.rate_hz)
    shares = _shares(config)
    gaps = sum(share > 0 for share in shares.values()) - 1
    span_s = _length_s(times)
    usable_s = span_s - gaps * config.gap_s
    subsets: dict[str, tuple[int, ...]] = {}
    begin = float(chosen[0]) if len(chosen) else 0.0
    for name in SUBSETS:
        end = begin + max(usable_s, 0.0) * shares[name] * 1e9
        # boundaries are half a nanosecond early, so that rounding does not decide where an instant belongs
        subsets[name] = tuple(int(t) for t in chosen[(chosen >= begin - 0.5) & (chosen < end - 0.5)])
        begin = end + (config.gap_s * 1e9 if shares[name] > 0 else 0.0)
    _check(subsets, shares, config, gaps, span_s)
    return Split(subsets, _left_out(instants, subsets))


def _length_s(times_ns: IntArray) -> float:
    """From the first of sorted times (N,) to the end of the last, which stands for one period of the footage's own."""
    if len(times_ns) < 2:
        return 0.0
    return float(times_ns[-1] - times_ns[0] + np.median(np.diff(times_ns))) * 1e-9


def at_rate(times_ns: IntArray, rate_hz: float) -> IntArray:
    """Of sorted times (N,), the first in every period of 1 / ``rate_hz`` since the first time."""
    if not len(times_ns):
        return times_ns
    # a hundredth of a period forgives rounded timestamps
    period = np.floor((times_ns - times_ns[0]) * (rate_hz * 1e-9) + 0.01).astype(np.int64)
    _, first = np.unique(period, return_index=True)
    return np.asarray(times_ns[first], dtype=np.int64)


def _shares(config: DatasetConfig) -> dict[str, float]:
    test = 1.0 - config.train_share - config.val_share
    return {"train": config.train_share, "val": config.val_share, "test": max(test, 0.0)}


def _check(
    subsets: Mapping[str, Sequence[int]], shares: Mapping[str, float], config: DatasetConfig, gaps: int, span_s: float
) -> None:
    if shares["test"] < 1e-6:
        raise TooFewInstants(
            "the shares of train and val leave nothing for test",
            hint="Lower dataset.train_share or dataset.val_share.",
        )
    short = [name for name in SUBSETS if shares[name] > 0 and len(subsets[name]) < MIN_INSTANTS]
    if not short:
        return
    smallest = min(shares[name] for name in short)
    needed_s = (MIN_INSTANTS + 1) / (smallest * config.rate_hz) + gaps * config.gap_s
    more_s = max(1, math.ceil(needed_s - span_s))
    remedies = [f"Record at least {more_s} s longer", "raise dataset.rate_hz"]
    if gaps * config.gap_s > _LARGE_GAPS * span_s:
        remedies.append(f"lower dataset.gap_s (gaps take {gaps * config.gap_s:g} s)")
    raise TooFewInstants(
        f"{span_s:.1f} s of footage gives {', '.join(f'{len(subsets[name])} {name} instants' for name in short)}; "
        f"{MIN_INSTANTS} of each are the least",
        hint=f"{', '.join(remedies[:-1])}, or {remedies[-1]}.",
        more_s=more_s,
    )


def _left_out(instants: Sequence[AnnotatedInstant], subsets: Mapping[str, Sequence[int]]) -> dict[str, frozenset[int]]:
    seen: dict[str, set[int]] = {}
    for name in SUBSETS:
        times = set(subsets[name])
        seen[name] = {
            vehicle.track_id
            for instant in instants
            if instant.time_ns in times
            for vehicle in instant.vehicles
            if vehicle.track_id >= 0
        }
    return {
        "train": frozenset(seen["train"] & (seen["val"] | seen["test"])),
        "val": frozenset(seen["val"] & seen["test"]),
        "test": frozenset(),
    }
