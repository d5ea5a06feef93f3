"""Plan views: cameras, clusters of rays, tracks, conflicts and boxes, seen from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, XY, YAW, footprints
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.ground import intersect_plane
from wibam_core.report.mosaic import Extent
from wibam_core.report.style import (
    BASELINE,
    CONFLICT_COLOURS,
    FINETUNED,
    GRID,
    INK,
    MUTED,
    TRUTH,
    camera_colour,
    new_figure,
    plain,
    tidy,
)
from wibam_core.road_users import CLASSES
from wibam_core.scene import CameraRig, Track

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Ground:
    """What a plan view lies on: the rectangle shown, and its orthophoto (rows, columns, 3), RGB, if there is one."""

    extent: Extent
    photo: NDArray[np.uint8] | None = None


@dataclass(frozen=True, eq=False)
class ClusteredInstant:
    """One instant's association, for a picture.

    Attributes:
        time_s: since the start of the recording.
        points: (N, 2) ground points of all boxes, m. cameras: (N,) number of each one's camera in the rig.
        clusters: (N,) number of each one's vehicle, −1 for none.
    """

    time_s: float
    points: Array
    cameras: NDArray[np.int64]
    clusters: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BoxesInstant:
    """Boxes (N, 7) of one instant by name: "baseline", "fine-tuned", "label"."""

    time_s: float
    boxes: Mapping[str, Array]


@dataclass(frozen=True)
class ConflictMark:
    """A conflict's place in a plan view."""

    number: int
    x_m: float
    y_m: float
    kind: str
    track_ids: tuple[int, int]


BOX_COLOURS: Mapping[str, str] = {"label": TRUTH, "baseline": BASELINE, "fine-tuned": FINETUNED}


def cluster_figure(rig: CameraRig, ground: Ground, instants: Sequence[ClusteredInstant]) -> Figure:
    """Rays of every camera's boxes to the ground, and the vehicles that they were clustered into."""
    figure, panels = _panels(len(instants), ground)
    for axes, instant in zip(panels, instants, strict=True):
        _prepare(axes, ground, f"t = {instant.time_s:.1f} s")
        _draw_rig(axes, rig, ground.extent, fields_of_view=False)
        centres = np.array([camera.centre_m[:2] for camera in rig.values()])
        for number in range(len(rig)):
            mine = instant.points[instant.cameras == number]
            rays = np.stack([np.broadcast_to(centres[number], mine.shape), mine], axis=1)
            axes.add_collection(LineCollection(list(rays), colors=camera_colour(number), linewidths=0.6, alpha=0.45))
            axes.plot(*mine.T, ".", color=camera_colour(number), markersize=5.5, markeredgecolor="white", mew=0.4)
        for cluster in np.unique(instant.clusters[instant.clusters >= 0]):
            members = instant.points[instant.clusters == cluster]
            _ring(axes, members)
    _legend(figure, [Line2D([], [], color=camera_colour(i), marker=".", label=c) for i, c in enumerate(rig)])
    return figure


def tracks_figure(
    rig: CameraRig, ground: Ground, tracks: Sequence[Track], conflicts: Sequence[ConflictMark] = ()
) -> Figure:
    """All tracks twice: coloured by class, with the conflicts, and by speed."""
    figure, (left, right) = _panels(2, ground)
    for axes, title in ((left, "by class"), (right, "by speed")):
        _prepare(axes, ground, title)
        _draw_rig(axes, rig, ground.extent)
    for vehicle_class in CLASSES:
        lines = [track.boxes[:, XY] for track in tracks if track.vehicle_class == vehicle_class and len(track) > 1]
        left.add_collection(LineCollection(lines, colors=vehicle_class.traits.colour, linewidths=1.1, alpha=0.75))
    _mark_conflicts(left, conflicts)
    _draw_speeds(figure, right, tracks)
    present = [c for c in CLASSES if any(track.vehicle_class == c for track in tracks)]
    handles = [Line2D([], [], color=c.traits.colour, linewidth=2, label=c.value) for c in present]
    _legend(figure, handles + _conflict_handles(conflicts))
    return figure


def conflicts_figure(
    rig: CameraRig,
    ground: Ground,
    tracks: Sequence[Track],
    conflicts: Sequence[ConflictMark],
    area: Sequence[Sequence[tuple[float, float]]] = (),
) -> Figure:
    """Where the conflicts happened, with the paths of those involved; numbers are those of the table.

    ``area`` are rings of x, y in m around the area where conflicts are told, and around its holes.
    """
    figure = new_figure(6.4, 6.6, fixed_aspect=True)
    axes = figure.subplots()
    _prepare(axes, ground, "")
    _draw_rig(axes, rig, ground.extent, fields_of_view=False)
    for ring in area:
        axes.add_patch(Polygon(ring, fill=False, edgecolor=INK, linestyle=":", linewidth=1.0, zorder=1.4))
    involved = {track_id: mark.kind for mark in conflicts for track_id in mark.track_ids}
    others = [track.boxes[:, XY] for track in tracks if track.track_id not in involved and len(track) > 1]
    # on a light casing, so that the grey shows on the orthophoto's grey road, too
    axes.add_collection(LineCollection(others, colors="white", linewidths=2.6, zorder=1.5))
    axes.add_collection(LineCollection(others, colors=MUTED, linewidths=1.2, zorder=1.6))
    for track in tracks:
        if track.track_id in involved:
            colour = CONFLICT_COLOURS.get(involved[track.track_id], INK)
            axes.plot(*track.boxes[:, XY].T, color=colour, linewidth=1.4, alpha=0.8)
    _mark_conflicts(axes, conflicts)
    _legend(figure, _conflict_handles(conflicts))
    return figure


def boxes_figure(rig: CameraRig, ground: Ground, instants: Sequence[BoxesInstant]) -> Figure:
    """Footprints of labels and of both networks' boxes at single instants; the notch marks the front."""
    figure, panels = _panels(len(instants), ground)
    for axes, instant in zip(panels, instants, strict=True):
        _prepare(axes, ground, f"t = {instant.time_s:.1f} s")
        _draw_rig(axes, rig, ground.extent, fields_of_view=False)
        for name, boxes in instant.boxes.items():
            draw_footprints(axes, boxes, BOX_COLOURS[name], filled=name == "label")
    names = [name for name in BOX_COLOURS if any(name in instant.boxes for instant in instants)]
    _legend(figure, [Line2D([], [], color=BOX_COLOURS[name], linewidth=2, label=name) for name in names])
    return figure


def draw_footprints(axes: Axes, boxes: Array, colour: str, *, filled: bool = False) -> None:
    """Ground rectangles of boxes (N, 7) with a line from the middle to the front."""
    if not len(boxes):
        return
    face = colour if filled else "none"
    axes.add_collection(
        PolyCollection(list(footprints(boxes)), edgecolors=colour, facecolors=face, alpha=0.35 if filled else 1.0)
    )
    forward = np.stack([np.cos(boxes[:, YAW]), np.sin(boxes[:, YAW])], axis=-1)
    ahead = boxes[:, XY] + 0.5 * boxes[:, LENGTH, None] * forward
    axes.add_collection(LineCollection(list(np.stack([boxes[:, XY], ahead], axis=1)), colors=colour, linewidths=1.0))


def field_of_view(camera: Camera, range_m: float) -> Array:
    """(N, 2) outline of the ground that a camera sees, cut off ``range_m`` from it."""
    w, h = camera.width_px - 0.5, camera.height_px - 0.5
    border = np.array(
        [[u, h] for u in np.linspace(-0.5, w, 12)]
        + [[w, v] for v in np.linspace(h, -0.5, 12)]
        + [[u, -0.5] for u in np.linspace(w, -0.5, 24)]
        + [[-0.5, v] for v in np.linspace(-0.5, h, 12)]
    )
    directions = camera.rays(border)[:, :2]
    directions = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    distance = np.linalg.norm(intersect_plane(camera, border)[:, :2] - camera.centre_m[:2], axis=1)
    return np.asarray(camera.centre_m[:2] + directions * np.fmin(distance, range_m)[:, None])


def _panels(count: int, ground: Ground) -> tuple[Figure, list[Axes]]:
    columns = min(max(count, 1), 2)
    rows = -(-max(count, 1) // columns)
    figure = new_figure(4.6 * columns, 4.6 * rows + 0.9, fixed_aspect=True)
    panels = list(figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat)
    for unused in panels[count:]:
        unused.set_visible(False)
    return figure, panels[:count]


def _prepare(axes: Axes, ground: Ground, title: str) -> None:
    e = ground.extent
    tidy(axes, title=title, x="x (m)", y="y (m)", grid="" if ground.photo is not None else "both")
    if ground.photo is not None:
        faded = np.asarray(255 - 0.5 * (255 - ground.photo.astype(np.float64)), dtype=np.uint8)
        axes.imshow(faded, extent=(e.x_min_m, e.x_max_m, e.y_min_m, e.y_max_m), interpolation="bilinear", zorder=0)
    axes.set_xlim(e.x_min_m, e.x_max_m)
    axes.set_ylim(e.y_min_m, e.y_max_m)
    axes.set_aspect("equal")


def _draw_rig(axes: Axes, rig: CameraRig, extent: Extent, *, fields_of_view: bool = True) -> None:
    side_m = extent.x_max_m - extent.x_min_m
    for number, (camera_id, camera) in enumerate(rig.items()):
        colour = camera_colour(number)
        if fields_of_view:
            outline = field_of_view(camera, 0.75 * side_m)
            axes.add_patch(
                Polygon(outline, closed=True, fill=False, edgecolor=colour, alpha=0.6, lw=0.8, ls=(0, (4, 3)))
            )
        axes.add_patch(
            Polygon(_wedge(camera, 0.045 * side_m), closed=True, facecolor=colour, alpha=0.85, lw=0, zorder=5)
        )
        axes.plot(*camera.centre_m[:2], "o", color=colour, markersize=5, markeredgecolor="white", mew=0.7, zorder=6)
        heading = camera.T_world_cam.rotate([0.0, 0.0, 1.0])[:2]
        name_at = camera.centre_m[:2] - 0.03 * side_m * heading / max(float(np.linalg.norm(heading)), 1e-9)
        x, y = (float(v) for v in name_at)
        axes.text(x, y, plain(camera_id), fontsize=7.5, color=INK, ha="center", va="center", zorder=7, clip_on=True)


def _wedge(camera: Camera, length_m: float) -> Array:
    """(N, 2) small sector in front of a camera, as wide as it sees."""
    row = 0.5 * (camera.height_px - 1)
    directions = camera.rays([[u, row] for u in np.linspace(-0.5, camera.width_px - 0.5, 9)])[:, :2]
    directions = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
    return np.concatenate([camera.centre_m[None, :2], camera.centre_m[:2] + length_m * directions])


def _ring(axes: Axes, members: Array) -> None:
    centre = members.mean(axis=0)
    radius = max(1.4, float(np.linalg.norm(members - centre, axis=1).max()) + 0.7)
    several = len(members) > 1
    angle = np.linspace(0, 2 * np.pi, 33)
    axes.plot(
        centre[0] + radius * np.cos(angle),
        centre[1] + radius * np.sin(angle),
        color=INK if several else MUTED,
        linewidth=1.1 if several else 0.7,
        linestyle="-" if several else ":",
    )
    if several:
        axes.annotate(
            str(len(members)), centre + np.array([0.75, 0.75]) * radius, fontsize=7.5, color=INK, annotation_clip=True
        )


def _draw_speeds(figure: Figure, axes: Axes, tracks: Sequence[Track]) -> None:
    pieces = [np.stack([t.boxes[:-1, XY], t.boxes[1:, XY]], axis=1) for t in tracks if len(t) > 1]
    speeds = [np.hypot(*t.velocities_mps[1:].T) * 3.6 for t in tracks if len(t) > 1]
    if not pieces:
        return
    kmh = np.concatenate(speeds)
    lines = LineCollection(list(np.concatenate(pieces)), array=kmh, cmap="viridis", linewidths=1.3)
    lines.set_clim(0.0, max(float(np.percentile(kmh, 99)), 1.0))
    axes.add_collection(lines)
    bar = figure.colorbar(lines, ax=axes, shrink=0.7, pad=0.01)
    bar.set_label("speed (km/h)", fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, colors=MUTED)
    bar.outline.set_edgecolor(GRID)


def _mark_conflicts(axes: Axes, conflicts: Sequence[ConflictMark]) -> None:
    for mark in conflicts:
        colour = CONFLICT_COLOURS.get(mark.kind, INK)
        axes.plot(mark.x_m, mark.y_m, "o", color=colour, markersize=11, markeredgecolor="white", zorder=7)
        axes.text(
            mark.x_m,
            mark.y_m,
            str(mark.number),
            fontsize=6.5,
            color="white",
            ha="center",
            va="center_baseline",
            clip_on=True,
            zorder=8,
        )


def _conflict_handles(conflicts: Sequence[ConflictMark]) -> list[Line2D]:
    kinds = sorted({mark.kind for mark in conflicts})
    return [
        Line2D([], [], marker="o", linestyle="", color=CONFLICT_COLOURS.get(k, INK), label=k.replace("_", " "))
        for k in kinds
    ]


def _legend(figure: Figure, handles: Sequence[Line2D]) -> None:
    if handles:
        figure.legend(
            handles=list(handles), loc="outside lower center", ncols=min(len(handles), 6), fontsize=8.5, frameon=False
        )
