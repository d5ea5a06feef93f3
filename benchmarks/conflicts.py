"""How true the conflicts are that come out: simulated sites whose traffic has near misses that are known exactly.

Drivers look away, force their way and run red (`synthetic.risks`). Which conflicts there are follows from the true
states by brute force (`benchmarks/conflict_truth.py`). Each camera's detections have the errors that a fine-tuned
network makes on rendered sites (`benchmarks/measure_network_errors.py`); tracker and safety are those of a job.
Rendering ten sites, and jobs on them, would take a day.

    python benchmarks/conflicts.py --sites 100 101 102 --cameras 4 1 --write docs/conflicts.json
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.conflict_truth import TrueConflict, true_conflicts
from benchmarks.network_errors import Errors, SimulatedNetwork
from wibam_core.config import SafetyConfig, TrackConfig
from wibam_core.geometry.box3d import XY
from wibam_core.safety.area import analysable_area
from wibam_core.safety.conflicts import Conflict, find_conflicts
from wibam_core.scene import Track
from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.risks import Risks
from wibam_core.synthetic.signals import SignalProgram
from wibam_core.synthetic.traffic import Traffic, simulate_traffic
from wibam_core.tracking.tracker import Tracker

Array = NDArray[np.float64]

PERIOD_NS = 160_000_000
SIZE_PX = (640, 360)
RADIUS_M = 60.0
RISKS = Risks(looking_away=0.12, forcing=0.25, running_red=0.15)
THRESHOLD_S = 1.5
#: Frames are exposed so much before or after the instant.
LATE_NS = 40_000_000


@dataclass(frozen=True)
class Site:
    number: int
    traffic: Traffic
    true: list[TrueConflict]
    wider: list[TrueConflict]


@dataclass(frozen=True)
class Row:
    """One site from so many cameras."""

    site: int
    cameras: int
    true: int
    found: int
    right: int
    precision: float | None
    recall: float | None
    outside: int
    area_m2: float
    tracks: int


@dataclass(frozen=True)
class Judged:
    """A conflict that was found, or one that was missed (probability 0)."""

    site: int
    cameras: int
    kind: str
    distance_m: float
    probability: float
    true: bool
    inside: bool
    interval_holds: bool | None


def make_site(number: int, seconds: float, cache: Path) -> Site:
    path = cache / f"traffic-{number}-{seconds:g}.pickle"
    if path.exists():
        kept: Site = pickle.loads(path.read_bytes())  # noqa: S301 - our own, of an earlier run
        return kept
    layout = make_layout(number)
    traffic = simulate_traffic(layout, number, seconds, SignalProgram(36.0), density=0.6, risks=RISKS)
    true = true_conflicts(traffic, ttc_s=THRESHOLD_S, pet_s=THRESHOLD_S, radius_m=RADIUS_M)
    wider = true_conflicts(traffic, ttc_s=2 * THRESHOLD_S, pet_s=2 * THRESHOLD_S, radius_m=RADIUS_M, braking_mps2=1.0)
    site = Site(number, traffic, true, wider)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickle.dumps(site))
    return site


def tracked(site: Site, cameras: int, errors: Errors) -> list[Track]:
    traffic, rng = site.traffic, np.random.default_rng([site.number, cameras, 7])
    views = site_cameras(traffic.layout, np.random.default_rng([site.number, 52]), 4, SIZE_PX)[:cameras]
    networks = [
        SimulatedNetwork(f"cam{k + 1}", view, errors, np.random.default_rng([site.number, k, 8]), PERIOD_NS * 1e-9)
        for k, view in enumerate(views)
    ]
    tracker = Tracker(TrackConfig())
    for instant in range(0, int(traffic.duration_s * 1e9), PERIOD_NS):
        frame_ns = max(0, instant + int(rng.integers(-LATE_NS, LATE_NS)))
        present, boxes = traffic.at(frame_ns * 1e-9)
        ids = [t.vehicle_id for t in present]
        classes = np.array([t.model.vehicle_class.number for t in present], np.int64)
        found = [network.detect(instant, ids, boxes, classes) for network in networks]
        tracker.step(instant, found, {network.camera_id: frame_ns for network in networks})
    return tracker.tracks()


class Vehicles:
    """Which true vehicle a track follows, around a time."""

    def __init__(self, traffic: Traffic) -> None:
        self._traffic = traffic
        self._at: dict[int, tuple[list[int], Array]] = {}

    def of(self, track: Track, time_ns: int) -> int | None:
        votes: dict[int, int] = defaultdict(int)
        for k in np.flatnonzero(np.abs(track.times_ns - time_ns) <= 1_000_000_000).tolist():
            ids, boxes = self._present(int(track.times_ns[k]))
            if not ids:
                continue
            gaps = np.hypot(*(boxes[:, XY] - track.boxes[k, XY]).T)
            nearest = int(gaps.argmin())
            if gaps[nearest] < 2.5:
                votes[ids[nearest]] += 1
        return max(votes, key=lambda vehicle: votes[vehicle]) if votes else None

    def _present(self, time_ns: int) -> tuple[list[int], Array]:
        if time_ns not in self._at:
            present, boxes = self._traffic.at(time_ns * 1e-9)
            self._at[time_ns] = [t.vehicle_id for t in present], boxes
        return self._at[time_ns]


def examine(
    site: Site, cameras: int, errors: Errors, config: SafetyConfig
) -> tuple[list[Judged], float, int, tuple[float, float]]:
    """What was found and missed, the area in m², the number of tracks, and the CPU-s of tracking and of safety."""
    start = time.process_time()
    tracks = tracked(site, cameras, errors)
    middle = time.process_time()
    conflicts = find_conflicts(tracks, config)
    inside = Inside(tracks, config)
    done = time.process_time()
    rows = list(judge(site, cameras, tracks, conflicts, inside))
    return rows, inside.area.area_m2, len(tracks), (middle - start, done - middle)


def judge(
    site: Site, cameras: int, tracks: Sequence[Track], conflicts: Sequence[Conflict], inside: Inside
) -> Iterator[Judged]:
    vehicles, by_id = Vehicles(site.traffic), {track.track_id: track for track in tracks}
    true = {c.ids: c for c in site.true}
    wider = {c.ids: c for c in site.wider}
    seen = set()
    for c in sorted(conflicts, key=lambda c: -_probability(c)):
        of = [vehicles.of(by_id[number], c.time_ns) for number in c.track_ids]
        ids = None if None in of else (min(of), max(of))  # type: ignore[type-var]
        right = ids in true and ids not in seen
        holds = None
        if ids in true or ids in wider:
            holds = _holds(c, true[ids] if ids in true else wider[ids])  # type: ignore[index]
        if right:
            seen.add(ids)
        place = (true[ids].x_m, true[ids].y_m) if right else (c.x_m, c.y_m)  # type: ignore[index]
        yield Judged(
            site.number, cameras, c.kind.value, float(np.hypot(*place)), _probability(c), right, inside(*place), holds
        )
    for conflict in site.true:
        if conflict.ids not in seen:
            kind = "by time to collision" if np.isfinite(conflict.ttc_s) else "by encroachment"
            place = conflict.x_m, conflict.y_m
            yield Judged(site.number, cameras, kind, float(np.hypot(*place)), 0.0, True, inside(*place), None)


class Inside:
    """Whether a place lies where a statement is made."""

    def __init__(self, tracks: Sequence[Track], config: SafetyConfig) -> None:
        self.area = analysable_area(tracks, config)

    def __call__(self, x_m: float, y_m: float) -> bool:
        return bool(self.area.holds(np.array([[x_m, y_m]]))[0])


def _probability(conflict: Conflict) -> float:
    return conflict.probability if np.isfinite(conflict.probability) else 1.0


def _holds(found: Conflict, true: TrueConflict) -> bool | None:
    """Whether the stated 90 % interval holds the true time; of the one that made it a conflict."""
    if np.isfinite(found.ttc_s) and np.isfinite(true.ttc_s):
        return found.ttc.low_s <= true.ttc_s <= found.ttc.high_s
    if np.isfinite(found.pet_s) and np.isfinite(true.pet_s):
        return found.pet.low_s <= true.pet_s <= found.pet.high_s
    return None


def summary(rows: Sequence[Judged], least: float) -> tuple[int, int, int]:
    """Numbers of true ones, found ones, and right ones among these, inside the area."""
    inside = [r for r in rows if r.inside]
    found = [r for r in inside if r.probability >= least]
    return sum(r.true for r in inside), len(found), sum(r.true for r in found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, nargs="+", default=list(range(100, 106)))
    parser.add_argument("--seconds", type=float, default=180.0)
    parser.add_argument("--cameras", type=int, nargs="+", default=[4, 1])
    parser.add_argument("--least", type=float, default=0.5, help="probability from which on a conflict counts as found")
    parser.add_argument("--errors", type=Path, default=None)
    parser.add_argument("--cache", type=Path, default=Path("build/conflicts"))
    parser.add_argument("--write", type=Path, default=None)
    parser.add_argument("--reuse", action="store_true", help="take what earlier runs found, where there is any")
    parser.add_argument(
        "--speed", type=float, default=None, metavar="MINUTES", help="time so much of 60 in view, and stop"
    )
    arguments = parser.parse_args()
    errors = Errors.read(arguments.errors) if arguments.errors else Errors.read()
    config = SafetyConfig(ttc_s=THRESHOLD_S, pet_s=THRESHOLD_S, min_probability=0.05)
    if arguments.speed:
        site = make_site(arguments.sites[0], arguments.seconds, arguments.cache)
        time_safety(tracked(site, 4, errors), 60, arguments.speed)
        return
    rows: list[Row] = []
    judged: list[Judged] = []
    print("site cameras  true found right  precision recall  true outside  area m²  tracks  s tracking  s safety")
    for number in arguments.sites:
        site = make_site(number, arguments.seconds, arguments.cache)
        for cameras in arguments.cameras:
            path = arguments.cache / f"result-{number}-{arguments.seconds:g}-{cameras}.pickle"
            if arguments.reuse and path.exists():
                result = pickle.loads(path.read_bytes())  # noqa: S301 - our own, of an earlier run
            else:
                result = examine(site, cameras, errors, config)
                path.write_bytes(pickle.dumps(result))
            of_site, area_m2, number_of_tracks, spent = result
            judged += of_site
            true, found, right = summary(of_site, arguments.least)
            row = Row(
                number,
                cameras,
                true,
                found,
                right,
                round(right / found, 3) if found else None,
                round(right / true, 3) if true else None,
                sum(r.true and not r.inside for r in of_site),
                round(area_m2),
                number_of_tracks,
            )
            rows.append(row)
            print(
                f"{number:4d} {cameras:7d} {true:5d} {found:5d} {right:5d}  {_two(row.precision):>9} "
                f"{_two(row.recall):>6}  {row.outside:12d}  {row.area_m2:7.0f}  {number_of_tracks:6d}"
                f"  {spent[0]:10.1f}  {spent[1]:8.1f}",
                flush=True,
            )
    for cameras in arguments.cameras:
        report(cameras, [r for r in judged if r.cameras == cameras], arguments.least)
    if arguments.write:
        document = {
            "command": f"python benchmarks/conflicts.py --seconds {arguments.seconds:g} --sites "
            + " ".join(map(str, arguments.sites)),
            "thresholds_s": {"ttc": THRESHOLD_S, "pet": THRESHOLD_S},
            "least_probability": arguments.least,
            "sites": [asdict(row) for row in rows],
            "by_type_and_distance": tables(judged, arguments.least),
        }
        arguments.write.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def crowded(tracks: Sequence[Track], users: int, minutes: float) -> list[Track]:
    """A longer recording with about so many road users in view: these tracks, beside and after each other."""
    begin, end = min(int(t.times_ns[0]) for t in tracks), max(int(t.times_ns[-1]) for t in tracks)
    period = (end - begin) // PERIOD_NS * PERIOD_NS + PERIOD_NS
    in_view = sum(len(t) for t in tracks) / (period / PERIOD_NS)
    copies, repeats = max(round(users / in_view), 1), round(minutes * 60e9 / period)
    found: list[Track] = []
    for repeat in range(repeats):
        for copy in range(copies):
            for track in tracks:
                boxes = track.boxes.copy()
                boxes[:, 0] += 120.0 * copy
                found.append(
                    replace(track, track_id=len(found), boxes=boxes, times_ns=track.times_ns + repeat * period)
                )
    return found


def time_safety(tracks: Sequence[Track], users: int, minutes: float) -> None:
    """Prints the CPU time of an hour, from so many minutes."""
    many = crowded(tracks, users, minutes)
    start = time.process_time()
    conflicts = find_conflicts(many, SafetyConfig())
    analysable_area(many, SafetyConfig())
    spent = time.process_time() - start
    lasted = (max(int(t.times_ns[-1]) for t in many) - min(int(t.times_ns[0]) for t in many)) * 1e-9
    in_view = sum(len(t) for t in many) * PERIOD_NS * 1e-9 / lasted
    print(f"{in_view:.0f} road users in view for {lasted / 60:.1f} min: {spent:.1f} CPU-s, {len(conflicts)} conflicts; "
          f"an hour {spent * 3600 / lasted:.0f} CPU-s")  # fmt: skip


def tables(judged: Sequence[Judged], least: float) -> list[Mapping[str, object]]:
    found: list[Mapping[str, object]] = []
    for cameras in sorted({r.cameras for r in judged}, reverse=True):
        of = [r for r in judged if r.cameras == cameras]
        parts = {kind: [r for r in of if r.kind == kind] for kind in sorted({r.kind for r in of})}
        parts |= {
            f"{low}–{high} m": [r for r in of if low <= r.distance_m < high]
            for low, high in ((0, 15), (15, 30), (30, 60))
        }
        for name, part in {"all": of, **parts}.items():
            true, count, right = summary(part, least)
            if true or count:
                found.append({"cameras": cameras, "part": name, "true": true, "found": count, "right": right})
    return found


def report(cameras: int, judged: Sequence[Judged], least: float) -> None:
    true, found, right = summary(judged, least)
    print(f"\n{cameras} cameras, all sites: {true} true, {found} found, {right} right: "
          f"precision {right / max(found, 1):.2f}, recall {right / max(true, 1):.2f}")  # fmt: skip
    for bound in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
        t, f, r = summary(judged, bound)
        print(f"  from probability {bound:.1f}: precision {r / max(f, 1):.2f}, recall {r / max(t, 1):.2f}")
    print("  reliability: stated probability, share that was true, number")
    inside = [r for r in judged if r.inside and r.probability > 0]
    for low in np.arange(0, 1, 0.2):
        part = [r for r in inside if low < r.probability <= low + 0.2]
        if part:
            print(
                f"    {np.mean([r.probability for r in part]):.2f}  {np.mean([r.true for r in part]):.2f}  {len(part)}"
            )
    held = [r.interval_holds for r in inside if r.interval_holds is not None and r.probability >= least]
    print(f"  90 % intervals hold the truth: {np.mean(held) if held else float('nan'):.2f} of {len(held)}")


def _two(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


if __name__ == "__main__":
    main()
