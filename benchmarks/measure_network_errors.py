"""How a fine-tuned network errs on rendered sites, measured.

Against the exact truth of simulated sites (`wibam simulate`) after their jobs (`wibam run`), camera by camera:
how large errors are by distance and by how much of a vehicle nearer ones hide, how they last, what is missed and for
how long, second boxes of one vehicle, boxes of nobody, headings that are turned. `benchmarks/network_errors.py` has
detections that nobody rendered err alike.

    python -m benchmarks.measure_network_errors SITE SITE/outputs [SITE OUTPUTS ...] --write errors.json
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.network_errors import COLUMNS, DISTANCES_M, HIDDEN, LONG_M, QUANTILES, Array, Errors, hidden_shares
from wibam_core.geometry.box3d import LENGTH, XY, YAW
from wibam_core.geometry.se3 import normalise_angle

_NEAR_M = 4.0


@dataclass
class _Seen:
    """All true vehicles in view, a row each: where, how hidden, whether detected, errors."""

    vehicle: list[tuple[str, str, int]] = field(default_factory=list)
    time_s: list[float] = field(default_factory=list)
    distance: list[float] = field(default_factory=list)
    hidden: list[float] = field(default_factory=list)
    length: list[float] = field(default_factory=list)
    found: list[bool] = field(default_factory=list)
    error: list[Array] = field(default_factory=list)
    stated: list[Array] = field(default_factory=list)
    score: list[float] = field(default_factory=list)
    turned: list[bool] = field(default_factory=list)
    second: list[bool] = field(default_factory=list)
    apart_along: list[float] = field(default_factory=list)


def look(site: Path, outputs: Path, seen: _Seen) -> tuple[int, int]:
    """Adds what the job's network does on the instants that tracking sees; returns pictures and boxes of nobody."""
    from wibam_core.artifacts.catalogue import FRAMES, WEIGHTS
    from wibam_core.evaluation.matching import assign
    from wibam_core.evaluation.uncertainty import SdFactors
    from wibam_core.formats.labels import read_labels
    from wibam_core.formats.rig import read_rig
    from wibam_core.models.network import predict
    from wibam_core.models.stored_frames import stored_frames
    from wibam_core.networks.registry import load_to_detect

    rig = read_rig(site / "truth" / "rig.json")
    labels = {instant.vehicles.time_ns: instant for instant in read_labels(site / "labels.parquet")}
    network = load_to_detect(WEIGHTS.codec.read(_artifact(outputs, "finetune", WEIGHTS.file)))
    store = FRAMES.codec.read(_artifact(outputs, "frames", FRAMES.file))
    factors = SdFactors(**network.card.sd_factors)
    instants = [instant for instant in store.thinned(5.0) if instant.time_ns in labels]
    # what it learned from, it knows better: the later half
    instants = instants[len(instants) // 2 :]
    exposed = {instant.time_ns: instant.frame_times_ns for instant in instants}
    times = np.array(sorted(labels))
    pictures = nobody = 0
    for raw in predict(network, stored_frames(store, instants, rig), decode=network.card.decode, min_score=0.3):
        vehicles = factors.apply(raw)
        camera_id = str(vehicles.camera_id)
        camera = rig[camera_id]
        # the truth when the picture was taken, between two labelled instants
        at = exposed[vehicles.time_ns][camera_id]
        boxes, ids = _between(labels, times, at)
        distances, hidden = hidden_shares(camera, boxes)
        inside = np.flatnonzero(~np.isnan(hidden) & (distances < DISTANCES_M[-1]))
        gaps = np.linalg.norm(boxes[:, None, XY] - vehicles.boxes[None, :, XY], axis=-1)
        rows, columns = assign(gaps, _NEAR_M)
        of = dict(zip(rows.tolist(), columns.tolist(), strict=True))
        left = np.setdiff1d(np.arange(len(vehicles)), columns)
        pictures += 1
        nobody += int((gaps[:, left].min(axis=0, initial=99.0) > _NEAR_M).sum())
        for i in inside.tolist():
            box = boxes[i]
            sight = (box[XY] - camera.T_world_cam.translation[:2]) / distances[i]
            seen.vehicle.append((site.name, camera_id, int(ids[i])))
            seen.time_s.append(at * 1e-9)
            seen.distance.append(float(distances[i]))
            seen.hidden.append(float(hidden[i]))
            seen.length.append(float(box[LENGTH]))
            seen.found.append(i in of)
            error, stated, score, turned, second, apart = (
                np.full(7, np.nan),
                np.full(7, np.nan),
                np.nan,
                False,
                False,
                0.0,
            )
            if i in of:
                own = vehicles.boxes[of[i]]
                offset = own[XY] - box[XY]
                yaw = float(normalise_angle(own[YAW] - box[YAW]))
                turned = abs(yaw) > np.pi / 2
                error = np.concatenate(
                    [[offset @ sight, offset[1] * sight[0] - offset[0] * sight[1]], own[2:6] - box[2:6], [0.0]]
                )
                error[6] = normalise_angle(2 * yaw) / 2
                sd = vehicles.sd[of[i]]
                c, s = np.abs(sight)
                stated = np.concatenate([[np.hypot(c * sd[0], s * sd[1]), np.hypot(s * sd[0], c * sd[1])], sd[2:]])
                score = float(vehicles.scores[of[i]])
                near = [
                    j for j in left.tolist() if gaps[:, j].argmin() == i and gaps[i, j] < max(_NEAR_M, box[LENGTH] / 2)
                ]
                second = bool(near)
                if near:
                    step = vehicles.boxes[near[0], XY] - own[XY]
                    apart = float(abs(step @ np.array([np.cos(box[YAW]), np.sin(box[YAW])])))
            for name, value in (("error", error), ("stated", stated), ("score", score), ("turned", turned)):
                getattr(seen, name).append(value)
            seen.second.append(second)
            seen.apart_along.append(apart)
    return pictures, nobody


def _artifact(outputs: Path, stage: str, name: str) -> Path:
    return next(path / name for path in sorted(outputs.glob(f"{stage}-*")) if (path / name).exists())


def _between(labels: dict[int, Any], times: Array, at_ns: int) -> tuple[Array, Array]:
    k = int(np.clip(np.searchsorted(times, at_ns), 1, len(times) - 1))
    before, after = labels[int(times[k - 1])].vehicles, labels[int(times[k])].vehicles
    share = np.clip((at_ns - times[k - 1]) / (times[k] - times[k - 1]), 0.0, 1.0)
    common, i, j = np.intersect1d(before.ids, after.ids, return_indices=True)
    boxes = before.boxes[i] + share * (after.boxes[j] - before.boxes[i])
    boxes[:, YAW] = before.boxes[i, YAW] + share * normalise_angle(after.boxes[j, YAW] - before.boxes[i, YAW])
    return boxes, common


def measure(seen: _Seen, pictures: int, nobody: int, sites: Sequence[str]) -> Errors:
    distance, hidden = np.searchsorted(DISTANCES_M, seen.distance), np.searchsorted(HIDDEN, seen.hidden)
    found, error, stated = np.array(seen.found), np.array(seen.error), np.array(seen.stated)
    good = found & (np.abs(error[:, 6]) < 1.0)
    clear = good & (hidden <= 1)
    missed = _filled(
        [[_share(~found[(distance == d) & (hidden == h)]) for h in range(len(HIDDEN))] for d in range(len(DISTANCES_M))]
    )
    sd = _filled([_robust(error[clear & (distance == d)]) for d in range(len(DISTANCES_M))])
    says = _filled([_median(stated[clear & (distance == d)]) for d in range(len(DISTANCES_M))])
    scaled = error / sd[np.minimum(distance, len(sd) - 1)]
    factor = np.array([float(np.nanmean(_robust(scaled[good & (hidden == h)])[:2])) for h in range(len(HIDDEN))])
    factor = np.maximum.accumulate(np.nan_to_num(factor, nan=1.0).clip(1.0))
    scaled /= factor[hidden][:, None]
    tails = np.quantile(scaled[good], QUANTILES, axis=0).T
    lasting, slow, slow_s = _correlations(seen, np.clip(scaled, -4, 4), good)
    spread = float(np.std(np.log(stated[clear, 1] / says[distance[clear], 1])))
    long = found & (np.array(seen.length) > LONG_M)
    second = np.array(seen.second)
    return Errors(
        sd=sd.tolist(),
        hidden_factor=factor.tolist(),
        tails=tails.tolist(),
        lasting=lasting.tolist(),
        slow=slow.tolist(),
        slow_s=slow_s,
        stated=says.tolist(),
        spread=spread,
        missed=missed.tolist(),
        missing_s=_missing_s(seen, missed[np.minimum(distance, len(missed) - 1), hidden]),
        doubled=_share(second[found & ~long]),
        cut=_share((second & (np.array(seen.apart_along) > 2.0))[long]),
        false_boxes=nobody / pictures,
        turned=_share(np.array(seen.turned)[found]),
        scores=np.quantile(np.array(seen.score)[found], [0, 0.25, 0.5, 0.75, 1]).tolist(),
        sites=list(sites),
    )


def _share(rows: NDArray[np.bool_]) -> float:
    return float(rows.mean()) if len(rows) >= 10 else float("nan")


def _robust(errors: Array) -> Array:
    if len(errors) < 30:
        return np.full(7, np.nan)
    return np.asarray(0.5 * np.diff(np.quantile(errors, [0.1587, 0.8413], axis=0), axis=0)[0])


def _median(values: Array) -> Array:
    return np.median(values, axis=0) if len(values) >= 30 else np.full(7, np.nan)


def _filled(table: Sequence[Any]) -> Array:
    """Bins with too few rows take their neighbour's value (the nearer, the less hidden one)."""
    values = np.array(table, np.float64)
    for row in range(1, len(values)):
        values[row] = np.where(np.isnan(values[row]), values[row - 1], values[row])
    for row in range(len(values) - 2, -1, -1):
        values[row] = np.where(np.isnan(values[row]), values[row + 1], values[row])
    for column in range(1, values.shape[1]):
        values[:, column] = np.where(np.isnan(values[:, column]), values[:, column - 1], values[:, column])
    return values


def _correlations(seen: _Seen, scaled: Array, good: NDArray[np.bool_]) -> tuple[Array, Array, float]:
    """From products of standardised errors of one vehicle in one camera, by the time between them."""
    lags_s = np.array([0.2, 0.4, 0.6, 0.8, 1.0, 1.6, 2.4, 3.2, 5.0])
    products, counts = np.zeros((len(lags_s), 7)), np.zeros(len(lags_s))
    rows_of: dict[tuple[str, str, int], list[int]] = {}
    for row in np.flatnonzero(good).tolist():
        rows_of.setdefault(seen.vehicle[row], []).append(row)
    times = np.array(seen.time_s)
    for rows in rows_of.values():
        gaps = times[rows][None, :] - times[rows][:, None]
        for k, lag in enumerate(lags_s):
            i, j = np.nonzero(np.abs(gaps - lag) < 0.09)
            products[k] += (scaled[rows][i] * scaled[rows][j]).sum(axis=0)
            counts[k] += len(i)
    correlation = products / counts[:, None] / np.mean(scaled[good] ** 2, axis=0)
    print("correlations of errors by lag:")
    for lag, row in zip(lags_s, correlation, strict=True):
        print(f"  {lag:4.1f} s  " + "  ".join(f"{name} {value:5.2f}" for name, value in zip(COLUMNS, row, strict=True)))
    from scipy.optimize import nnls

    best: tuple[float, Array, Array, float] | None = None
    for slow_s in np.arange(0.4, 3.01, 0.2).tolist():
        basis = np.stack([np.ones(len(lags_s)), np.exp(-lags_s / slow_s)], axis=1)
        fits = [nnls(basis, column) for column in correlation.T]
        wrong = float(sum(residual**2 for _, residual in fits))
        if best is None or wrong < best[0]:
            best = wrong, np.array([x[0] for x, _ in fits]), np.array([x[1] for x, _ in fits]), slow_s
    assert best is not None
    total = np.maximum(best[1] + best[2], 1.0)
    return best[1] / total, best[2] / total, best[3]


def _missing_s(seen: _Seen, expected: Array) -> float:
    """Time in which being missed beyond what is expected is forgotten."""
    missing = ~np.array(seen.found) - expected
    before: dict[tuple[str, str, int], int] = {}
    num = den = 0.0
    for row, vehicle in enumerate(seen.vehicle):
        if vehicle in before and seen.time_s[row] - seen.time_s[before[vehicle]] < 0.3:
            num += missing[row] * missing[before[vehicle]]
            den += 0.5 * (missing[row] ** 2 + missing[before[vehicle]] ** 2)
        before[vehicle] = row
    return float(-0.2 / np.log(np.clip(num / max(den, 1e-9), 0.05, 0.97)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+", help="site and outputs, in turn")
    parser.add_argument("--write", type=Path, default=None)
    arguments = parser.parse_args()
    seen, pictures, nobody = _Seen(), 0, 0
    pairs = list(zip(arguments.folders[::2], arguments.folders[1::2], strict=True))
    for site, outputs in pairs:
        more = look(site, outputs, seen)
        pictures, nobody = pictures + more[0], nobody + more[1]
    errors = measure(seen, pictures, nobody, [site.name for site, _ in pairs])
    text = json.dumps({f.name: asdict(errors)[f.name] for f in fields(errors)}, indent=1)
    print(text)
    if arguments.write:
        arguments.write.write_text(_rounded(text) + "\n", encoding="utf-8")


def _rounded(text: str) -> str:
    return json.dumps(json.loads(text, parse_float=lambda number: round(float(number), 4)), indent=1)


if __name__ == "__main__":
    main()
