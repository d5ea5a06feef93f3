"""A report's text and tables, ready for the template: every value is a string for a person."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wibam_core.documents.conflicts import ConflictRow, Exposure
from wibam_core.documents.metrics import Metrics
from wibam_core.documents.statistics import SubsetStatistics
from wibam_core.documents.synchronisation import SoundPair, TrafficPair
from wibam_core.documents.warnings import StageWarning
from wibam_core.report.advice import advice
from wibam_core.report.cameras import overlap_rows, overlap_text, refined_rows, refinement_text
from wibam_core.report.data import Dataset, ReportData
from wibam_core.report.pictures import MAX_CONFLICTS, Picture, Pictures
from wibam_core.report.results import NETWORKS, ResultRow, compared, result_rows, z_tests
from wibam_core.report.rounds import ROUND_TITLES, round_rows, rounds_text
from wibam_core.report.words import NONE, braking, interval, mean_sd, number, percent, signed
from wibam_core.safety.measures import MEASURES

_KINDS = {
    "matrices": "ready matrices",
    "pnp": "points, known lens",
    "homography": "ground points",
    "points": "points, lens solved",
}
_FARTHEST_ZONE_M = 80.0


@dataclass(frozen=True)
class Tile:
    """A headline figure, and what it was before fine-tuning."""

    name: str
    value: str
    before: str = ""


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
    warnings: tuple[StageWarning, ...]
    contents: tuple[tuple[str, str], ...]
    pictures: Pictures
    has_labels: bool
    test_part: str
    networks: tuple[str, ...]
    results: tuple[ResultRow, ...]
    z_tests: str
    consistency: tuple[tuple[str, ...], ...]
    uncertainties: tuple[tuple[str, ...], ...]
    examples: tuple[ExamplePage, ...]
    tracks_text: str
    conflicts_text: str
    conflicts_caption: str
    most_braking: str
    measures: tuple[tuple[str, str], ...]
    conflicts: tuple[tuple[str, ...], ...]
    conflicts_left_out: int
    synchronised: bool
    clocks: tuple[tuple[str, ...], ...]
    clock_candidates: tuple[tuple[str, ...], ...]
    traffic_pairs: tuple[tuple[str, ...], ...]
    sound_pairs: tuple[tuple[str, ...], ...]
    placed_segments: tuple[tuple[str, ...], ...]
    zones: tuple[str, ...]
    calibration: tuple[tuple[str, ...], ...]
    rounds_text: str
    round_titles: tuple[str, ...]
    rounds: tuple[tuple[str, ...], ...]
    overlaps: tuple[tuple[str, ...], ...]
    overlap_text: str
    refinement_text: str
    refined: tuple[tuple[str, ...], ...]
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
        warnings=data.warnings,
        contents=_contents(pictures),
        pictures=pictures,
        has_labels=metrics.finetuned is not None,
        test_part=f"{metrics.instants} instants, {metrics.frames} images",
        networks=tuple(compared(metrics).values()),
        results=result_rows(metrics),
        z_tests=z_tests(metrics),
        consistency=_consistency(metrics),
        uncertainties=_uncertainties(metrics),
        examples=tuple(
            ExamplePage(f"t = {example.time_s:.1f} s, predicted in {example.camera_id}", drawn)
            for example, drawn in zip(data.examples, pictures.examples, strict=True)
        ),
        tracks_text=_tracks_text(data),
        conflicts_text=_conflicts_text(data),
        conflicts_caption=_conflicts_caption(data),
        most_braking=braking(math.inf),
        measures=tuple((measure.title, measure.meaning) for measure in MEASURES),
        conflicts=tuple(
            conflict_cells(number, row) for number, row in enumerate(data.conflicts[:MAX_CONFLICTS], start=1)
        ),
        conflicts_left_out=max(len(data.conflicts) - MAX_CONFLICTS, 0),
        synchronised=data.synchronisation.measured,
        clocks=_clocks(data),
        clock_candidates=_candidates(data),
        traffic_pairs=_traffic_pairs(data),
        sound_pairs=tuple(_sound_pair(pair) for pair in data.synchronisation.sounds),
        placed_segments=tuple(
            (id_, f"{one.from_s:.1f}", f"{signed(one.shift_s, 3)} ± {one.sd_s:.3f}", str(one.matched))
            for id_, one in data.synchronisation.segments
        ),
        zones=tuple(f"{low:g}–{high:g} m" for low, high in _zones(data)),
        calibration=_calibration(data),
        rounds_text=rounds_text(data.rounds),
        round_titles=ROUND_TITLES,
        rounds=round_rows(data.rounds),
        overlaps=overlap_rows(data.overlap),
        overlap_text=overlap_text(data.overlap),
        refinement_text=refinement_text(data.refinement),
        refined=refined_rows(data.refinement),
        dataset_text=_dataset_text(data.dataset),
        subsets=tuple(_subset(name, part) for name, part in data.dataset.subsets.items()),
        training_facts=data.training.facts,
        version=data.version,
        stages=tuple((row.title, row.hash[:16], number(row.seconds, 1)) for row in data.stages),
        options=data.options,
    )


def _consistency(metrics: Metrics) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            title,
            number(value.found, 2),
            mean_sd(value.other_views),
            mean_sd(value.own_view),
            mean_sd(value.roughness_m),
            str(value.pairs),
        )
        for name, title in NETWORKS.items()
        if (value := metrics.self_consistency.get(name)) is not None
    )


def _uncertainties(metrics: Metrics) -> tuple[tuple[str, ...], ...]:
    """Per kind of number: the factor that was applied, and how right standard deviations are without and with it."""
    learned, calibrated = ((metrics.reliability or {}).get(name, {}) for name in ("finetuned_as_learned", "finetuned"))
    rows = []
    for kind, title in (("position", "position"), ("size", "size"), ("yaw", "heading")):
        before, after = learned.get(kind), calibrated.get(kind)
        if before is None or after is None or not after.count:
            continue
        errors = (
            "" if one.calibration_error is None else percent(one.calibration_error.laplace) for one in (before, after)
        )
        factor = (metrics.sd_factors or {}).get(kind)
        rows.append((title, str(after.count), number(before.scale_factor, 2), number(factor, 2), *errors))
    return tuple(rows)


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
            Tile("vehicles found", percent(after.recall.mean), percent(before.recall.mean)),
        ]
    else:
        before_found, after_found = (_of_views(data.metrics, name)[0] for name in ("baseline", "finetuned"))
        before_iou, after_iou = (_of_views(data.metrics, name)[1] for name in ("baseline", "finetuned"))
        quality = [
            Tile("found of what several views see", percent(after_found), percent(before_found)),
            Tile("agreement of views where found", number(after_iou, 2), number(before_iou, 2)),
        ]
    return (*quality, Tile("tracks", str(len(data.tracks))), Tile("conflicts", str(len(data.conflicts))))


def _of_views(metrics: Metrics, name: str) -> tuple[float | None, float | None]:
    """Share of the sightings that a network finds, and their mean overlap in the other views."""
    value = metrics.self_consistency.get(name)
    return (None, None) if value is None else (value.found, value.other_views.mean)


def _contents(pictures: Pictures) -> tuple[tuple[str, str], ...]:
    parts = (pictures.by_distance, pictures.by_visibility, pictures.by_elevation, pictures.by_class)
    return (
        ("results", "Before and after"),
        ("pictures", "Pictures"),
        ("tracks", "Tracks"),
        ("conflicts", "Conflicts"),
        *((("where", "Where it is good"),) if any(parts) else ()),
        *((("uncertainties", "Uncertainties"),) if pictures.reliability else ()),
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
        f"{limits['pet_s']:g} s.{_exposure_text(data.exposure)}"
    )


def _exposure_text(exposure: Exposure | None) -> str:
    if exposure is None:
        return ""
    elsewhere = exposure.conflicts_elsewhere
    return (
        f" They are told of {exposure.area_m2:.0f} m², where tracks are good enough to say so, and where road users "
        f"spent {60 * exposure.road_user_hours:.1f} minutes and went {exposure.road_user_km:.1f} km while "
        f"{60 * exposure.hours:.1f} minutes were recorded."
        + (f" {elsewhere} more that look like conflicts outside are not told." if elsewhere else "")
    )


def _conflicts_caption(data: ReportData) -> str:
    involved = {track_id for row in data.conflicts[:MAX_CONFLICTS] for track_id in row.track_ids}
    others = "; all other tracks are grey" if any(track.track_id not in involved for track in data.tracks) else ""
    area = "; dotted: the area of which conflicts are told" if data.exposure is not None else ""
    return f"Where the conflicts of the table happened, with the paths of those involved{others}{area}."


def conflict_cells(place: int, row: ConflictRow) -> tuple[str, ...]:
    """One conflict as the cells of its row."""
    return (
        str(place),
        f"{row.time_ns / 1e9:.1f} s",
        row.type.replace("_", " "),
        f"{row.track_ids[0]} – {row.track_ids[1]}",
        f"{row.classes[0]} – {row.classes[1]}",
        interval(row.ttc_s, row.ttc_interval_s),
        percent(row.probability),
        interval(row.pet_s, row.pet_interval_s),
        f"{3.6 * row.speeds_mps[0]:.0f} – {3.6 * row.speeds_mps[1]:.0f}",
        braking(None if row.ttc_s is None else row.deceleration_mps2),
        *(number(row.measures.get(measure.name), measure.digits) for measure in MEASURES),
    )


def _dataset_text(dataset: Dataset) -> str:
    return (
        f"{dataset.detected_boxes} boxes of all cameras were clustered on the ground into vehicles that several "
        f"cameras see at once; {percent(dataset.unassociated_share)} of the boxes met none of another camera, and "
        f"{dataset.single_view} times a vehicle was seen by one camera alone. These vehicles, not hand labels, are "
        "what the network learned from."
    )


def _subset(name: str, part: SubsetStatistics) -> tuple[str, ...]:
    numbers = (part.instants, part.vehicles, part.boxes, part.tracks, part.left_out_tracks)
    return (name, f"{part.seconds:.0f}", *(str(value) for value in numbers))


def _clocks(data: ReportData) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            row.camera_id,
            signed(row.offset_s, 4)
            + ("" if row.offset_sd_s is None else f" ± {row.offset_sd_s:.4f}")
            + (", ambiguous" if row.ambiguous else "")
            + (", by the traffic" if row.by_traffic else "")
            + (", by the sound" if row.by_sound else ""),
            signed(row.drift_ppm, 1) + ("" if row.drift_sd_ppm is None else f" ± {row.drift_sd_ppm:.1f}"),
            str(row.changes) + ("" if row.score is None else f" ({row.score:.0%} of possible)"),
            number(None if row.rms_before_s is None else 1e3 * row.rms_before_s, 1),
            number(None if row.rms_after_s is None else 1e3 * row.rms_after_s, 1),
        )
        for row in data.synchronisation.clocks
    )


def _candidates(data: ReportData) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            camera_id,
            signed(other.offset_s, 2),
            signed(other.drift_ppm, 0),
            f"{other.matched} of {other.could:.0f} ({other.score:.0%})",
            "excluded" if other.excluded else "as likely",
        )
        for camera_id, other in data.synchronisation.candidates
    )


def _traffic_pairs(data: ReportData) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            f"{pair.second} against {pair.first}",
            signed(pair.offset_s, 3) + ("" if pair.sd_s is None else f" ± {pair.sd_s:.3f}"),
            signed(pair.drift_ppm, 0) + ("" if pair.drift_sd_ppm is None else f" ± {pair.drift_sd_ppm:.0f}"),
            f"{pair.matched} of {pair.could:.0f} ({pair.score:.0%})",
            NONE if pair.residual_s is None else signed(1e3 * pair.residual_s, 1),
            "used" if pair.clear else "not used: " + _others(pair),
        )
        for pair in data.synchronisation.pairs
    )


def _sound_pair(pair: SoundPair) -> tuple[str, ...]:
    verdict = "agrees" if pair.agrees else "says otherwise" if pair.clear else "not used: not clear"
    offset = f"{signed(pair.offset_s, 2)} ± {pair.sd_s:.2f}"
    return f"{pair.second} against {pair.first}", offset, f"{pair.contrast:.1f}", signed(pair.residual_s, 2), verdict


def _others(pair: TrafficPair) -> str:
    rivals = [other for other in pair.alternatives if not other.excluded]
    if not rivals:
        return "too few road users"
    return " or ".join(f"{other.offset_s:+.2f} s ({other.score:.0%})" for other in rivals[:3]) + " as likely"


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
        spreads = (number(row.position_sd_m, 2), number(row.ground_sd_m, 2))
        pixels = (number(row.pixel_m.get(zone), 3) for zone in _zones(data))
        rows.append((row.camera_id, shown, _KINDS.get(row.kind, row.kind), used, *errors, *spreads, *pixels))
    return tuple(rows)
