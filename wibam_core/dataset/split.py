"""The split in time: three contiguous parts with gaps between them, and no vehicle in two of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from wibam_core.config import DatasetConfig
from wibam_core.documents.split import SUBSETS, Split
from wibam_core.errors import TooFewInstants
from wibam_core.scene import AnnotatedInstant, IntArray

#: A subset with fewer instants than this cannot say anything.
MIN_INSTANTS = 4
#: Gaps that take more than this share of the footage are worth a word.
_LARGE_GAPS = 0.2


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
    return Split(times_ns=subsets, left_out_tracks=seen_later(instants, subsets))


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


def seen_later(instants: Sequence[AnnotatedInstant], subsets: Mapping[str, Sequence[int]]) -> dict[str, frozenset[int]]:
    """Subset -> tracks that a later subset sees, too.

    Args:
        instants: associated.
        subsets: subset -> its instants, ns; those that are not among ``instants`` see nothing.
    """
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
