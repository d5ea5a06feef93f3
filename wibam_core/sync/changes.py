"""Traffic-light changes seen in regions of a recording, in one pass over its frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from wibam_core.clocks import SignalChange
from wibam_core.errors import InputError
from wibam_core.site import SignalRegion
from wibam_core.sync.lamps import BINS, COLOURS, colour_profile, learn_lamps
from wibam_core.sync.states import STATES, most_likely_states, state_evidence, switch_costs
from wibam_core.video.windows import Window

Image = NDArray[np.uint8]
Array = NDArray[np.float64]

#: A frame shows a state when its evidence for it reaches this.
_CLEAR = 0.25
#: Evidence this long before and after a change makes its confidence.
_CONFIDENCE_WINDOW_S = 1.0


class RegionWatcher:
    """Collects what one signal region shows. Keeps 36 numbers a frame, never a frame.

    Attributes:
        signal: the region as it was given.
        window: what of the image is looked at.
    """

    def __init__(self, signal: SignalRegion, width_px: int, height_px: int) -> None:
        """
        Args:
            signal: the region, px of the recording.
            width_px: the recording's width.
            height_px: the recording's height.

        Raises:
            InputError: if less than 2 x 4 px of the region lie in the image.
        """
        x, y, width, height = signal.region
        x0, y0 = max(round(x), 0), max(round(y), 0)
        x1, y1 = min(round(x + width), width_px), min(round(y + height), height_px)
        if min(x1 - x0, y1 - y0) < 2 or max(x1 - x0, y1 - y0) < 4:
            raise InputError(
                f"signal {signal.id}: region {x:g},{y:g},{width:g},{height:g} has less than 2 x 4 px "
                f"in an image of {width_px}x{height_px}",
                hint="Give x, y, width, height in pixels of the recording, around all lamps of one signal head.",
                signal=signal.id,
            )
        self.signal = signal
        self.window: Window = (x0, y0, x1, y1)
        self._times_ns: list[int] = []
        self._profiles: list[Array] = []

    def add(self, time_ns: int, image: Image) -> None:
        """Look at the next frame: its time on the camera's own clock, and the window's image (h, w, 3), BGR."""
        self._times_ns.append(time_ns)
        self._profiles.append(colour_profile(image).astype(np.float32))

    def changes(self, camera_id: str, min_lit_share: float) -> list[SignalChange]:
        """The changes in all frames added so far, by time, see `changes_of_profiles`."""
        times_ns = np.array(self._times_ns, dtype=np.int64)
        profiles = np.array(self._profiles, dtype=np.float64).reshape(-1, len(COLOURS), BINS)
        return changes_of_profiles(camera_id, self.signal.id, times_ns, profiles, min_lit_share)


def changes_of_profiles(
    camera_id: str, signal_id: str, times_ns: NDArray[np.int64], profiles: Array, min_lit_share: float
) -> list[SignalChange]:
    """Changes of a signal from its colour profiles (T, 3, BINS) at increasing ``times_ns`` (T,).

    There are none if less than ``min_lit_share`` of the frames clearly shows a state: that is no signal head.

    A change is put in the middle between the last frame that clearly shows the old state and the first that clearly
    shows the new one; half the time between them is its ``half_interval_ns``. Confidence is how clear the states are
    within a second around the change, lowered where the change itself was hidden (by 1/e for a second).
    """
    if len(times_ns) < 2:
        return []
    lamps = learn_lamps(profiles)
    if sum(lamps.seen) < 2:
        return []
    evidence = state_evidence(*lamps.unmix(profiles))
    if (evidence.max(axis=1) > _CLEAR).mean() < min_lit_share:
        return []
    path = most_likely_states(times_ns, evidence, switch_costs(lamps.seen))
    frame_ns = float(np.median(np.diff(times_ns)))
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(path)) + 1, [len(path)]])
    found = []
    for begin, switch, end in zip(bounds[:-2], bounds[1:-1], bounds[2:], strict=True):
        old, new = int(path[switch - 1]), int(path[switch])
        last = _edge(evidence[begin:switch, old][::-1])
        first = _edge(evidence[switch:end, new])
        if last is None or first is None:
            continue
        last_ns, first_ns = int(times_ns[switch - 1 - last]), int(times_ns[switch + first])
        hidden_s = max(first_ns - last_ns - 2 * frame_ns, 0.0) / 1e9
        before = _clarity(times_ns[begin:switch][::-1], evidence[begin:switch, old][::-1])
        after = _clarity(times_ns[switch:end], evidence[switch:end, new])
        found.append(
            SignalChange(
                camera_id=camera_id,
                signal_id=signal_id,
                time_ns=(last_ns + first_ns) // 2,
                before=STATES[old],
                after=STATES[new],
                confidence=float(np.clip(np.sqrt(before * after) * np.exp(-hidden_s), 0.0, 1.0)),
                half_interval_ns=(first_ns - last_ns + 1) // 2,
            )
        )
    return found


def _edge(evidence: Array) -> int | None:
    """Index of the first frame that clearly shows the state."""
    clear = np.flatnonzero(evidence > _CLEAR)
    return int(clear[0]) if len(clear) else None


def _clarity(times_ns: NDArray[np.int64], evidence: Array) -> float:
    """Mean evidence over the first `_CONFIDENCE_WINDOW_S` of a state, at least three frames where there are."""
    near = np.abs(times_ns - times_ns[0]) <= _CONFIDENCE_WINDOW_S * 1e9
    near[:3] = True
    return float(evidence[near].mean())


class SignalWatch:
    """Collects what all signal regions of one camera show, in one pass over its frames.

    Args:
        camera_id: whose frames.
        signals: regions, px of the frames.
        width_px, height_px: of the frames.

    Raises:
        InputError: if a region lies outside the image.
    """

    def __init__(self, camera_id: str, signals: Sequence[SignalRegion], width_px: int, height_px: int) -> None:
        self._camera_id = camera_id
        self._watchers = [RegionWatcher(signal, width_px, height_px) for signal in signals]

    @property
    def windows(self) -> list[Window]:
        """What of the image is looked at, a window a region."""
        return [watcher.window for watcher in self._watchers]

    def add(self, time_ns: int, images: Sequence[Image]) -> None:
        """Look at the next frame: its time on the camera's own clock, and each window's image (h, w, 3), BGR."""
        for watcher, image in zip(self._watchers, images, strict=True):
            watcher.add(time_ns, image)

    def changes(self, min_lit_share: float) -> list[SignalChange]:
        """Changes of all signals in all frames added so far, by time.

        Where several regions carry the same signal id, the one whose changes are clearest speaks for it.

        Args:
            min_lit_share: of its frames in which a region must clearly show a state.
        """
        best: dict[str, list[SignalChange]] = {}
        for watcher in self._watchers:
            found = watcher.changes(self._camera_id, min_lit_share)
            held = best.get(watcher.signal.id, [])
            if sum(c.confidence for c in found) > sum(c.confidence for c in held):
                best[watcher.signal.id] = found
        return sorted((change for found in best.values() for change in found), key=lambda change: change.time_ns)


def detect_changes(
    frames: Iterable[tuple[int, Image]], camera_id: str, signals: Sequence[SignalRegion], min_lit_share: float
) -> list[SignalChange]:
    """Changes of several signals of one camera in whole images, as `SignalWatch` finds them.

    Args:
        frames: (time_ns on the camera's own clock, BGR image), in order; one frame is held at a time.
        camera_id: whose frames.
        signals: regions, px of the frames.
        min_lit_share: of its frames in which a region must clearly show a state.

    Raises:
        InputError: if a region lies outside the image.
    """
    watch: SignalWatch | None = None
    for time_ns, image in frames:
        watch = watch or SignalWatch(camera_id, signals, image.shape[1], image.shape[0])
        watch.add(time_ns, [image[y0:y1, x0:x1] for x0, y0, x1, y1 in watch.windows])
    return watch.changes(min_lit_share) if watch else []
