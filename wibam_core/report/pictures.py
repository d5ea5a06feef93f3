"""All pictures of a report, drawn from its data and encoded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from wibam_core.documents.metrics import Bin, OfClass, Part, Reliability
from wibam_core.report import bev, charts
from wibam_core.report.bev import BoxesInstant, ConflictMark, Ground
from wibam_core.report.data import Array, Example, Image, ReportData
from wibam_core.report.encode import EXAMPLE_WIDTH_PX, jpeg_uri, svg_uri, webp_uri
from wibam_core.report.mosaic import Extent, ground_mosaic, where_traffic_is
from wibam_core.report.overlay import draw_boxes
from wibam_core.report.style import BASELINE, FINETUNED, bgr

#: Conflicts that are numbered in the table and on the map.
MAX_CONFLICTS = 60
#: Side of the orthophoto, px.
_PHOTO_PX = 600
_WHITE = (255, 255, 255)


@dataclass(frozen=True)
class Picture:
    """A data URI, what it shows, for those who cannot see it, and its width on the page."""

    uri: str
    alt: str
    width_px: int


@dataclass(frozen=True)
class Pictures:
    """Those that the data allow; None where there is nothing to show."""

    before_after: Picture | None
    by_distance: Picture | None
    by_visibility: Picture | None
    by_elevation: Picture | None
    by_class: Picture | None
    reliability: Picture | None
    tracks: Picture | None
    conflicts: Picture | None
    boxes: Picture | None
    clusters: Picture | None
    delays: Picture | None
    distributions: Picture | None
    curves: Picture | None
    examples: tuple[tuple[tuple[Picture, str], ...], ...]


def _vector(figure: Figure, alt: str) -> Picture:
    return Picture(svg_uri(figure), alt, _width_px(figure))


def _raster(figure: Figure, alt: str) -> Picture:
    return Picture(webp_uri(figure), alt, _width_px(figure))


def _width_px(figure: Figure) -> int:
    return round(96 * float(figure.get_size_inches()[0]))


def draw_pictures(data: ReportData) -> Pictures:
    """Draw everything."""
    ground = _ground(data)
    marks = conflict_marks(data)
    return Pictures(
        before_after=_before_after(data),
        by_distance=_bins(data.metrics.by_distance, "distance", "distance (m)"),
        by_visibility=_bins(data.metrics.by_visibility, "visibility", "visible share (%)", percent=True),
        by_elevation=_bins(data.metrics.by_elevation, "elevation", "elevation angle (°)"),
        by_class=_classes(data.metrics.by_class),
        reliability=_reliability(data.metrics.reliability),
        tracks=_raster(
            bev.tracks_figure(data.rig, ground, data.tracks, marks),
            f"Plan view of {len(data.tracks)} tracks, {len(data.rig)} cameras and {len(marks)} conflicts.",
        )
        if data.tracks
        else None,
        conflicts=_raster(
            bev.conflicts_figure(
                data.rig, ground, data.tracks, marks, data.exposure.outlines_m if data.exposure else ()
            ),
            f"Plan view of {len(marks)} conflicts and the paths of those involved.",
        )
        if marks
        else None,
        boxes=_boxes(data, ground),
        clusters=_clusters(data),
        delays=_delays(data),
        distributions=_vector(
            charts.distributions_figure(data.dataset.plots),
            "Bar charts of " + ", ".join(plot.title for plot in data.dataset.plots) + " in the annotation set.",
        )
        if data.dataset.plots
        else None,
        curves=_vector(
            charts.curves_figure(data.training.totals, data.training.parts, data.training.kept_step),
            "Loss over training steps: " + ", ".join(curve.name for curve in data.training.totals) + ", and its parts.",
        )
        if data.training.totals
        else None,
        examples=tuple(_example(example) for example in data.examples),
    )


def conflict_marks(data: ReportData) -> list[ConflictMark]:
    """The first `MAX_CONFLICTS` conflicts, numbered from 1 as in the table."""
    return [
        ConflictMark(number, row.x_m, row.y_m, row.type, row.track_ids)
        for number, row in enumerate(data.conflicts[:MAX_CONFLICTS], start=1)
    ]


def _ground(data: ReportData) -> Ground:
    extent = Extent.around(where_traffic_is(data.rig, data.tracks))
    if not data.typical_images:
        return Ground(extent)
    cell_m = (extent.x_max_m - extent.x_min_m) / _PHOTO_PX
    return Ground(extent, ground_mosaic(data.rig, data.typical_images, extent, cell_m))


def _before_after(data: ReportData) -> Picture | None:
    before, after = data.metrics.baseline, data.metrics.finetuned
    if before is None or after is None:
        return None
    return _vector(
        charts.before_after_figure(before, after),
        "Bars of BEV IoU, 3D IoU, recall, ATE, ASE and AOE, baseline beside fine-tuned; the table has the figures.",
    )


def _bins(bins: Mapping[str, Sequence[Bin]] | None, by: str, axis: str, *, percent: bool = False) -> Picture | None:
    parts = {
        network: {charts.interval_name(one.low, one.high, percent=percent): one for one in of}
        for network, of in (bins or {}).items()
    }
    return _parts(parts, by, axis)


def _classes(classes: Mapping[str, Sequence[OfClass]] | None) -> Picture | None:
    parts = {network: {one.road_user_class: one for one in of} for network, of in (classes or {}).items()}
    return _parts(parts, "class", "class")


def _parts(parts: Mapping[str, Mapping[str, Part]], by: str, axis: str) -> Picture | None:
    if not any(parts.values()):
        return None
    return _vector(charts.parts_figure(parts, axis), f"BEV IoU, ATE and recall by {by}, baseline beside fine-tuned.")


def _reliability(reliability: Mapping[str, Mapping[str, Reliability]] | None) -> Picture | None:
    stated = [kind for of in (reliability or {}).values() for kind in of.values() if kind.count]
    if not reliability or not stated:
        return None
    return _vector(
        charts.reliability_figure(reliability),
        "Shares of the errors of position, size and heading in the intervals that should hold them, and root mean "
        "square errors by stated standard deviation.",
    )


def _boxes(data: ReportData, ground: Ground) -> Picture | None:
    instants = [instant for instant in data.boxes if any(len(boxes) for boxes in instant.boxes.values())]
    if not instants:
        return None
    return _raster(
        bev.boxes_figure(data.rig, ground, instants),
        f"Plan views of the boxes of {_names(instants)} at {len(instants)} instants of the test part.",
    )


def _names(instants: Sequence[BoxesInstant]) -> str:
    return ", ".join(dict.fromkeys(name for instant in instants for name in instant.boxes))


def _clusters(data: ReportData) -> Picture | None:
    if not data.clusters:
        return None
    cameras = np.array([camera.centre_m[:2] for camera in data.rig.values()])
    ground = Ground(Extent.around(np.concatenate([cameras, *(instant.points for instant in data.clusters)])))
    return _vector(
        bev.cluster_figure(data.rig, ground, data.clusters),
        f"Plan views of rays from {len(data.rig)} cameras and their clusters at {len(data.clusters)} instants.",
    )


def _delays(data: ReportData) -> Picture | None:
    if not data.synchronisation.delays:
        return None
    frame_ms = max((1e3 / recording.fps for recording in data.recordings), default=None)
    return _vector(
        charts.delays_figure(data.synchronisation.delays, tuple(data.rig), frame_ms),
        "Delay of each light change to the reference camera over time, before and after synchronisation.",
    )


def _example(example: Example) -> tuple[tuple[Picture, str], ...]:
    views = [example.camera_id] + ([example.other_id] if example.other_id is not None else [])
    return tuple(
        _reprojection(example, camera_id, name, boxes, colour)
        for camera_id in views
        for name, boxes, colour in (
            ("baseline", example.baseline, BASELINE),
            ("fine-tuned", example.finetuned, FINETUNED),
        )
    )


def _reprojection(example: Example, camera_id: str, name: str, boxes: Array, colour: str) -> tuple[Picture, str]:
    image: Image = example.images[camera_id]
    camera = example.cameras[camera_id]
    if example.labels is not None:
        image = draw_boxes(image, camera, example.labels, _WHITE, thickness_px=1, mark_front=False)
    image = draw_boxes(image, camera, boxes, bgr(colour))
    seen = "the view it saw" if camera_id == example.camera_id else f"predicted in {example.camera_id}"
    caption = f"{name}, {camera_id} ({seen})"
    alt = f"{len(boxes)} boxes of the {name} network in {camera_id}, {seen}."
    return Picture(jpeg_uri(image), alt, min(image.shape[1], EXAMPLE_WIDTH_PX)), caption
