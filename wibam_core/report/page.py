"""A report's text and tables, ready for the template: every value is a string for a person."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from wibam_core.report.advice import SIGNIFICANT, advice
from wibam_core.report.data import Dataset, ReportData, SubsetRow
from wibam_core.report.inputs import ConflictRow, DetectorFigures, MeanSd, Metrics, Significance
from wibam_core.report.pictures import MAX_CONFLICTS, Picture, Pictures

#: Means and standard deviations published for the method, on the authors' own test set.
PUBLISHED: Mapping[str, tuple[MeanSd, MeanSd]] = {
    "bev_iou": (MeanSd(mean=0.33, sd=0.25), MeanSd(mean=0.64, sd=0.13)),
    "iou_3d": (MeanSd(mean=0.25, sd=0.18), MeanSd(mean=0.48, sd=0.09)),
    "ate_m": (MeanSd(mean=1.51, sd=0.97), MeanSd(mean=0.43, sd=0.43)),
    "ase": (MeanSd(mean=0.12, sd=0.06), MeanSd(mean=0.23, sd=0.07)),
    "aoe_deg": (MeanSd(mean=5.67, sd=5.47), MeanSd(mean=4.69, sd=2.91)),
}
NONE = "–"
_NETWORKS = {
    "baseline_depth": "baseline (depth)",
    "baseline": "baseline (plane)",
    "finetuned": "fine-tuned",
}

_KINDS = {"matrices": "ready matrices", "pnp": "points, known lens", "homography": "ground points"}
_FARTHEST_ZONE_M = 80.0


@dataclass(frozen=True)
class Tile:
    """A headline figure, and what it was before fine-tuning."""

    name: str
    value: str
    before: str = ""


@dataclass(frozen=True)
class Cell:
    """A figure, and beneath it its spread."""

    value: str
    spread: str = ""


_Triple = tuple[Cell, Cell, Cell]


@dataclass(frozen=True)
class ResultRow:
    """One metric. ``verdict`` is "better", "worse" or "" where the change may be chance."""

    name: str
    correct: _Triple
    change: Cell
    verdict: str
    paper_compat: _Triple
    published: tuple[Cell, Cell]


@dataclass(frozen=True)
class ExamplePage:
    title: str
    pictures: tuple[tuple[Picture, str], ...]


@dataclass(frozen=True)
class Page:
    """What the template shows, in its order."""

    site_name: str
    done: str
    tiles: tuple[Tile, ...]
    advice: tuple[str, ...]
    contents: tuple[tuple[str, str], ...]
    pictures: Pictures
    has_labels: bool
    test_part: str
    results: tuple[ResultRow, ...]
    z_tests: str
    consistency: tuple[tuple[str, ...], ...]
    examples: tuple[ExamplePage, ...]
    tracks_text: str
    conflicts_text: str
    conflicts: tuple[tuple[str, ...], ...]
    conflicts_left_out: int
    sync_warnings: tuple[str, ...]
    clocks: tuple[tuple[str, ...], ...]
    zones: tuple[str, ...]
    calibration: tuple[tuple[str, ...], ...]
    dataset_text: str
    subsets: tuple[tuple[str, ...], ...]
    training_facts: tuple[tuple[str, str], ...]
    version: str
    stages: tuple[tuple[str, str, str], ...]
    options: tuple[tuple[str, str], ...]


def build_page(data: ReportData, pictures: Pictures) -> Page:
    """Put a report's data into words and tables."""
    metrics = data.metrics
    return Page(
        site_name=data.site_name,
        done=_done(data),
        tiles=_tiles(data),
        advice=tuple(advice(metrics)),
        contents=_contents(pictures),
        pictures=pictures,
        has_labels=metrics.finetuned is not None,
        test_part=f"{metrics.instants} instants, {metrics.frames} images",
        results=result_rows(metrics),
        z_tests=_z_tests(metrics),
        consistency=_consistency(metrics),
        examples=tuple(
            ExamplePage(f"t = {example.time_s:.1f} s, predicted in {example.camera_id}", drawn)
            for example, drawn in zip(data.examples, pictures.examples, strict=True)
        ),
        tracks_text=_tracks_text(data),
        conflicts_text=_conflicts_text(data),
        conflicts=tuple(
            conflict_cells(number, row) for number, row in enumerate(data.conflicts[:MAX_CONFLICTS], start=1)
        ),
        conflicts_left_out=max(len(data.conflicts) - MAX_CONFLICTS, 0),
        sync_warnings=data.synchronisation.warnings,
        clocks=_clocks(data),
        zones=tuple(f"{low:g}–{high:g} m" for low, high in _zones(data)),
        calibration=_calibration(data),
        dataset_text=_dataset_text(data.dataset),
        subsets=tuple(_subset(row) for row in data.dataset.subsets),
        training_facts=data.training.facts,
        version=data.version,
        stages=tuple((row.title, row.digest[:16], number(row.seconds, 1)) for row in data.stages),
        options=data.options,
    )


def number(value: float | None, digits: int) -> str:
    """A number, or a dash."""
    return NONE if value is None else f"{value:.{digits}f}"


def signed(value: float, digits: int) -> str:
    """A number with its sign, as it is printed."""
    return f"{value:+.{digits}f}".replace("-", "−")


def mean_sd(value: MeanSd, digits: int = 2) -> str:
    """``mean ± s.d.``"""
    if value.mean is None:
        return NONE
    return number(value.mean, digits) + ("" if value.sd is None else f" ± {value.sd:.{digits}f}")


def interval(value: float | None, ends: tuple[float | None, float | None], digits: int = 2) -> str:
    """``value [low, high]``; an end without bound is ∞."""
    if value is None:
        return NONE
    low, high = ("∞" if end is None else f"{end:.{digits}f}" for end in ends)
    return f"{value:.{digits}f} [{low}, {high}]"


def result_rows(metrics: Metrics) -> tuple[ResultRow, ...]:
    """The before/after table: empty without labels."""
    if metrics.baseline is None or metrics.finetuned is None:
        return ()
    networks = (metrics.baseline_depth, metrics.baseline, metrics.finetuned)
    compat = tuple((metrics.paper_compat or {}).get(name) for name in _NETWORKS)
    tests = metrics.significance or {}
    measured = [
        _metric_row(name, title, digits, networks, compat, tests.get(name))
        for name, title, digits in (
            ("bev_iou", "BEV IoU", 2),
            ("iou_3d", "3D IoU", 2),
            ("ate_m", "ATE (m)", 2),
            ("ase", "ASE", 3),
            ("aoe_deg", "AOE (°)", 1),
            ("recall", "recall", 2),
            ("bev_iou_misses_zero", "BEV IoU, misses as zero", 2),
            ("iou_3d_misses_zero", "3D IoU, misses as zero", 2),
        )
    ]
    counted = [
        ResultRow(title, _counts(networks, name), Cell(""), "", _counts(compat, name), (Cell(""), Cell("")))
        for name, title in (("matched", "matched"), ("missed", "missed"), ("false_positives", "false positives"))
    ]
    aliased = ResultRow(
        "AOE of 150° and more", _alias_shares(networks), Cell(""), "", _alias_shares(compat), (Cell(""), Cell(""))
    )
    return (*measured, aliased, *counted)


def _metric_row(
    name: str,
    title: str,
    digits: int,
    networks: tuple[DetectorFigures | None, ...],
    compat: tuple[DetectorFigures | None, ...],
    test: Significance | None,
) -> ResultRow:
    change, verdict = _change(name, digits, test)
    before, after = (_cell(value, digits) for value in PUBLISHED.get(name, (None, None)))
    return ResultRow(
        title, _cells(networks, name, digits), change, verdict, _cells(compat, name, digits), (before, after)
    )


def _cell(value: MeanSd | None, digits: int) -> Cell:
    if value is None:
        return Cell("")
    return Cell(number(value.mean, digits), "" if value.sd is None else f"± {value.sd:.{digits}f}")


def _cells(networks: tuple[DetectorFigures | None, ...], name: str, digits: int) -> _Triple:
    first, second, third = (_cell(getattr(one, name, MeanSd()), digits) for one in networks)
    return first, second, third


def _alias_shares(networks: tuple[DetectorFigures | None, ...]) -> _Triple:
    first, second, third = (
        Cell(NONE if figures is None or figures.alias_share is None else f"{100 * figures.alias_share:.1f} %")
        for figures in networks
    )
    return first, second, third


def _counts(networks: tuple[DetectorFigures | None, ...], name: str) -> _Triple:
    first, second, third = (_count(None if one is None else getattr(one, name)) for one in networks)
    return first, second, third


def _count(value: int | None) -> Cell:
    return Cell(NONE if value is None else f"{value}")


def _change(name: str, digits: int, test: Significance | None) -> tuple[Cell, str]:
    if test is None or test.difference is None:
        return Cell(""), ""
    p = test.p_bootstrap
    mark = "" if p is None or p >= 0.05 else " **" if p < SIGNIFICANT else " *"
    higher_is_better = name in ("bev_iou", "iou_3d")
    verdict = "" if not mark else "better" if (test.difference > 0) == higher_is_better else "worse"
    low, high = (None if end is None else signed(end, digits) for end in (test.low, test.high))
    ends = "" if low is None or high is None else f"{low} to {high}"
    return Cell(signed(test.difference, digits) + mark, ends), verdict


def _z_tests(metrics: Metrics) -> str:
    tests = metrics.significance or {}
    chance = [name for name, test in tests.items() if test.p_z is None or test.p_z >= SIGNIFICANT]
    if not tests:
        return ""
    if not chance:
        return "By the paper's Z-test over single boxes all five differences are significant at 0.01."
    named = ", ".join(_title(name) for name in chance)
    return f"By the paper's Z-test over single boxes all differences but {named} are significant at 0.01."


def _title(name: str) -> str:
    return {"bev_iou": "BEV IoU", "iou_3d": "3D IoU", "ate_m": "ATE", "ase": "ASE", "aoe_deg": "AOE"}.get(name, name)


def _consistency(metrics: Metrics) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (title, mean_sd(value.other_views), mean_sd(value.own_view), str(value.pairs), number(value.found, 2))
        for name, title in _NETWORKS.items()
        if (value := metrics.self_consistency.get(name)) is not None
    )


def _done(data: ReportData) -> str:
    longest = max((recording.duration_s for recording in data.recordings), default=0.0)
    return (
        f"{len(data.rig)} cameras recorded for {_duration(longest)}. Their clocks were aligned, vehicles were found in "
        "2D and matched between the views, a monocular 3D detector was fine-tuned on them without one hand label, and "
        "all vehicles were tracked in 7DoF (x, y, z, length, width, height, yaw)."
    )


def _duration(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"


def _tiles(data: ReportData) -> tuple[Tile, ...]:
    before, after = data.metrics.baseline, data.metrics.finetuned
    if before is not None and after is not None:
        quality = [
            Tile("BEV IoU", number(after.bev_iou.mean, 2), number(before.bev_iou.mean, 2)),
            Tile("position error", f"{number(after.ate_m.mean, 2)} m", f"{number(before.ate_m.mean, 2)} m"),
            Tile("vehicles found", _percent(after.recall.mean), _percent(before.recall.mean)),
        ]
    else:
        agreement = {name: value.other_views.mean for name, value in data.metrics.self_consistency.items()}
        quality = [
            Tile("agreement of views", number(agreement.get("finetuned"), 2), number(agreement.get("baseline"), 2))
        ]
    return (*quality, Tile("tracks", str(len(data.tracks))), Tile("conflicts", str(len(data.conflicts))))


def _percent(share: float | None) -> str:
    return NONE if share is None else f"{100 * share:.0f} %"


def _contents(pictures: Pictures) -> tuple[tuple[str, str], ...]:
    binned = pictures.by_distance is not None or pictures.by_visibility is not None
    return (
        ("results", "Before and after"),
        ("pictures", "Pictures"),
        ("tracks", "Tracks"),
        ("conflicts", "Conflicts"),
        *((("where", "Where it is good"),) if binned else ()),
        ("synchronisation", "Synchronisation"),
        ("calibration", "Calibration"),
        ("dataset", "Annotation set"),
        ("training", "Training"),
        ("provenance", "Provenance"),
    )


def _tracks_text(data: ReportData) -> str:
    if not data.tracks:
        return "No track was found."
    states = sum(len(track) for track in data.tracks)
    seconds = sum(float(track.times_ns[-1] - track.times_ns[0]) for track in data.tracks) / 1e9 / len(data.tracks)
    return f"{len(data.tracks)} tracks with {states} states, {seconds:.1f} s long on average."


def _conflicts_text(data: ReportData) -> str:
    limits = data.conflict_thresholds
    found = (
        f"{len(data.conflicts)} conflict{'' if len(data.conflicts) == 1 else 's'}" if data.conflicts else "No conflict"
    )
    return (
        f"{found} with a time to collision below {limits['ttc_s']:g} s or a post-encroachment time below "
        f"{limits['pet_s']:g} s."
    )


def conflict_cells(place: int, row: ConflictRow) -> tuple[str, ...]:
    """One conflict as the cells of its row."""
    return (
        str(place),
        f"{row.time_ns / 1e9:.1f} s",
        row.type.replace("_", " "),
        f"{row.track_ids[0]} – {row.track_ids[1]}",
        f"{row.classes[0]} – {row.classes[1]}",
        interval(row.ttc_s, row.ttc_interval_s),
        _percent(row.probability),
        interval(row.pet_s, row.pet_interval_s),
        f"{3.6 * row.speeds_mps[0]:.0f} – {3.6 * row.speeds_mps[1]:.0f}",
        number(None if row.ttc_s is None else row.deceleration_mps2, 1),
    )


def _dataset_text(dataset: Dataset) -> str:
    return (
        f"{dataset.detected_boxes} boxes of all cameras were clustered on the ground into vehicles that several "
        f"cameras see at once; {_percent(dataset.unassociated_share)} of the boxes met none of another camera, and "
        f"{dataset.single_view} times a vehicle was seen by one camera alone. These vehicles, not hand labels, are "
        "what the network learned from."
    )


def _subset(row: SubsetRow) -> tuple[str, ...]:
    numbers = (row.instants, row.vehicles, row.boxes, row.tracks, row.left_out_tracks)
    return (row.name, f"{row.seconds:.0f}", *(str(value) for value in numbers))


def _clocks(data: ReportData) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            row.camera_id,
            signed(row.offset_s, 4) + ("" if row.offset_sd_s is None else f" ± {row.offset_sd_s:.4f}"),
            signed(row.drift_ppm, 1) + ("" if row.drift_sd_ppm is None else f" ± {row.drift_sd_ppm:.1f}"),
            str(row.changes),
            number(None if row.rms_before_s is None else 1e3 * row.rms_before_s, 1),
            number(None if row.rms_after_s is None else 1e3 * row.rms_after_s, 1),
        )
        for row in data.synchronisation.clocks
    )


def _zones(data: ReportData) -> list[tuple[float, float]]:
    """Bands of distance in which any camera sees the ground, without the farthest."""
    return sorted({zone for row in data.calibration for zone in row.pixel_m if zone[1] <= _FARTHEST_ZONE_M})


def _calibration(data: ReportData) -> tuple[tuple[str, ...], ...]:
    recordings = {recording.camera_id: recording for recording in data.recordings}
    rows = []
    for row in data.calibration:
        file = recordings.get(row.camera_id)
        shown = NONE if file is None else f"{file.width_px} × {file.height_px}, {file.fps:.2f} fps, {file.codec}"
        used = f"{row.points}" + (f" ({row.rejected} rejected)" if row.rejected else "")
        errors = (number(row.median_px, 2), number(row.max_px, 2), number(row.median_m, 3))
        pixels = (number(row.pixel_m.get(zone), 3) for zone in _zones(data))
        rows.append((row.camera_id, shown, _KINDS.get(row.kind, row.kind), used, *errors, *pixels))
    return tuple(rows)
