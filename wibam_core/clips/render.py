"""Rendering a clip: instant by instant, the plan and the cameras' frames with the road users drawn in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactReader
from wibam_core.clips.colours import FASTEST_MPS, Bgr, colour_of, speed_colour
from wibam_core.clips.layout import Panel, arrange
from wibam_core.clips.plan import ALERT, INK, PlanFrame, draw_footprint, label, legend, scale_bar, write
from wibam_core.clips.selection import Moment, moments
from wibam_core.documents.clips import ClipFacts, ClipSpec
from wibam_core.documents.conflicts import ConflictRow
from wibam_core.errors import Conflict, InputError
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.box3d import XY, YAW, footprints
from wibam_core.geometry.camera import Camera
from wibam_core.progress import Progress, silent
from wibam_core.report.mosaic import Extent, ground_mosaic, typical_images, where_traffic_is
from wibam_core.report.overlay import draw_boxes
from wibam_core.report.style import bgr
from wibam_core.scene import CameraRig, FrameSet, Track
from wibam_core.video.encode import VideoWriter

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: A frame that was exposed at another time than this beside the instant is not shown.
_NEAR_NS = 120_000_000
#: A conflict is marked for so long before and after its time.
_CONFLICT_NS = 1_000_000_000
#: A clip of nothing but instants far apart still names a rate.
_LEAST_FPS = 1.0
_MOSAIC_CELL_PX = 2
#: A view that is wider than this has thicker lines.
_WIDE_PX = 800
_PAPER: Bgr = (250, 248, 246)
_DARK: Bgr = (29, 24, 20)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """The road users of one moment, ready to be drawn.

    Attributes:
        boxes: (N, 7). velocities_mps: (N, 2). yaw_rates_radps: (N,).
        colours: of each. marked: (N,) whether each is in a conflict now.
    """

    moment: Moment
    boxes: Array
    velocities_mps: Array
    yaw_rates_radps: Array
    colours: tuple[Bgr, ...]
    marked: NDArray[np.bool_]

    @property
    def line_colours(self) -> list[Bgr]:
        """Of the boxes in the views."""
        return [ALERT if marked else colour for colour, marked in zip(self.colours, self.marked, strict=True)]

    def boxes_at(self, time_ns: int) -> Array:
        """(N, 7) moved to when a camera exposed its frame, which may be a little earlier or later."""
        step_s = (time_ns - self.moment.time_ns) / 1e9
        moved = self.boxes.copy()
        moved[:, XY] += step_s * self.velocities_mps
        moved[:, YAW] += step_s * self.yaw_rates_radps
        return moved


class ClipRenderer:
    """Draws a stretch of a job's results.

    Args:
        artifacts: of the job: cameras, frames and tracks, and its conflicts where there are any.
        spec: what to draw.

    Raises:
        Conflict: tracks or frames are not there yet.
        InputError: nothing was tracked in that stretch.
    """

    def __init__(self, artifacts: ArtifactReader, spec: ClipSpec) -> None:
        for artifact in (catalogue.RIG, catalogue.FRAMES, catalogue.TRACKS):
            if not artifacts.has(artifact):
                raise Conflict(
                    f"there is no {artifact.name} yet", hint="Wait until the job has tracked its road users."
                )
        self._spec = spec
        self._rig: CameraRig = artifacts.read(catalogue.RIG)
        self._store: FrameStore = artifacts.read(catalogue.FRAMES)
        self._tracks = artifacts.read(catalogue.TRACKS)
        has_conflicts = artifacts.has(catalogue.CONFLICTS)
        self._conflicts = artifacts.read(catalogue.CONFLICTS).conflicts if has_conflicts else []
        self._moments = moments(self._tracks, spec)
        if not self._moments:
            raise InputError(
                "nothing was tracked in that stretch", hint="Choose a stretch in which the player shows road users."
            )
        self._cameras = [camera_id for camera_id in self._rig if camera_id in self._store.camera_ids]
        first = self._rig[self._cameras[0]]
        self._layout = arrange(spec.width_px, len(self._cameras), first.width_px / first.height_px)

    def render(self, target: Path, progress: Progress = silent) -> ClipFacts:
        """Write the clip as H.264 in an MP4 file, whose frames are as far apart as their instants.

        Args:
            target: the file; replaced if it exists.
            progress: told how far it is.
        """
        layout, seen = self._layout, set[int]()
        first_ns = self._moments[0].time_ns
        with VideoWriter(target, layout.width_px, layout.height_px, self._fps, crf=23) as writer:
            for number, moment in enumerate(self._moments):
                writer.write(self.frame(moment), round((moment.time_ns - first_ns) / self._spec.speed))
                seen |= {track.track_id for track in moment.tracks}
                progress((number + 1) / len(self._moments), f"{number + 1} of {len(self._moments)} instants")
        return ClipFacts(
            frames=len(self._moments),
            first_ns=first_ns,
            last_ns=self._moments[-1].time_ns,
            width_px=layout.width_px,
            height_px=layout.height_px,
            road_users=len(seen),
        )

    @property
    def moments(self) -> list[Moment]:
        """The instants of the clip, ascending."""
        return self._moments

    def frame(self, moment: Moment) -> Image:
        """(height, width, 3), BGR: everything at one instant."""
        whole: Image = np.full((self._layout.height_px, self._layout.width_px, 3), _DARK, dtype=np.uint8)
        conflicts = [one for one in self._conflicts if abs(one.time_ns - moment.time_ns) <= _CONFLICT_NS]
        drawn = self._drawn(moment, conflicts)
        _put(whole, self._layout.plan, self._plan_image(drawn, conflicts))
        for camera_id, panel in zip(self._cameras, self._layout.views, strict=True):
            _put(whole, panel, self._view(camera_id, panel, drawn))
        _put(whole, self._layout.strip, self._strip(moment))
        return whole

    @cached_property
    def _fps(self) -> float:
        steps_ns = np.diff([moment.time_ns for moment in self._moments])
        return max(1e9 / float(np.median(steps_ns)) * self._spec.speed, _LEAST_FPS) if len(steps_ns) else _LEAST_FPS

    def _drawn(self, moment: Moment, conflicts: list[ConflictRow]) -> _Drawn:
        rows = list(zip(moment.tracks, moment.rows, strict=True))
        involved = {track_id for one in conflicts for track_id in one.track_ids}
        velocities = np.array([track.velocities_mps[row] for track, row in rows]).reshape(-1, 2)
        return _Drawn(
            moment,
            np.array([track.boxes[row] for track, row in rows]).reshape(-1, 7),
            velocities,
            np.array([track.yaw_rates_radps[row] for track, row in rows]),
            tuple(
                colour_of(track, float(np.hypot(*velocity)), self._spec)
                for (track, _), velocity in zip(rows, velocities, strict=True)
            ),
            np.array([track.track_id in involved for track, _ in rows], dtype=bool),
        )

    # --- the plan --------------------------------------------------------------------------------
    @cached_property
    def _plan(self) -> PlanFrame:
        return PlanFrame.around(Extent.around(where_traffic_is(self._rig, self._tracks)), self._layout.plan)

    @cached_property
    def _ground(self) -> Image:
        """The plan without anybody: what the cameras see of the road, pale, with the cameras and a scale."""
        panel, plan = self._layout.plan, self._plan
        typical = typical_images(self._store, self._rig)
        photo = ground_mosaic(self._rig, typical, plan.extent, _MOSAIC_CELL_PX / plan.px_per_m)
        faded = np.asarray(255 - 0.5 * (255 - photo[..., ::-1].astype(np.float64)), dtype=np.uint8)
        image = np.asarray(cv2.resize(faded, (panel.width_px, panel.height_px), interpolation=cv2.INTER_LINEAR))
        for camera_id in self._cameras:
            self._draw_camera(image, camera_id, self._rig[camera_id])
        if self._spec.polygon:
            plan.line(image, self._spec.polygon, INK, 2, closed=True)
        scale_bar(image, plan)
        return image

    def _draw_camera(self, image: Image, camera_id: str, camera: Camera) -> None:
        forward = camera.T_world_cam.rotation[:2, 2]
        forward = forward / max(float(np.hypot(*forward)), 1e-9)
        across = np.array([-forward[1], forward[0]])
        at, size = camera.centre_m[:2], 12.0 / self._plan.px_per_m
        self._plan.fill(image, [at, at + size * (forward + 0.6 * across), at + size * (forward - 0.6 * across)], INK)
        u, v = (int(value) for value in self._plan.px(at))
        height, width = image.shape[:2]
        left, top = min(max(u + 8, 4), width - 9 * len(camera_id) - 4), min(max(v - 8, 16), height - 40)
        write(image, camera_id, (left, top))

    def _plan_image(self, drawn: _Drawn, conflicts: list[ConflictRow]) -> Image:
        image = self._ground.copy()
        if self._spec.trail_s > 0:
            for track, row, colour in zip(drawn.moment.tracks, drawn.moment.rows, drawn.colours, strict=True):
                trail = self._trail(track, int(row))
                if len(trail) > 1:
                    self._plan.line(image, trail, colour, 2)
        for corners, colour, marked in zip(footprints(drawn.boxes), drawn.colours, drawn.marked, strict=True):
            draw_footprint(image, self._plan, corners, colour, marked=bool(marked))
        for conflict in conflicts:
            self._plan.ring(image, (conflict.x_m, conflict.y_m), 16, ALERT)
        return image

    def _trail(self, track: Track, row: int) -> Array:
        since = np.searchsorted(track.times_ns, track.times_ns[row] - round(self._spec.trail_s * 1e9))
        return track.boxes[int(since) : row + 1, XY]

    # --- the views -------------------------------------------------------------------------------
    @cached_property
    def _frames(self) -> Mapping[str, tuple[NDArray[np.int64], list[FrameSet]]]:
        """Camera id -> when its frames of instants were exposed, ascending, and those instants."""
        found = {}
        for camera_id in self._cameras:
            sets = [one for one in self._store.frame_sets if camera_id in one.frame_times_ns]
            sets.sort(key=lambda one: one.frame_times_ns[camera_id])
            found[camera_id] = (np.array([one.frame_times_ns[camera_id] for one in sets], np.int64), sets)
        return found

    def _view(self, camera_id: str, panel: Panel, drawn: _Drawn) -> Image:
        found = self._frame_near(camera_id, drawn.moment.time_ns)
        if found is None:
            image: Image = np.full((panel.height_px, panel.width_px, 3), _DARK, dtype=np.uint8)
            write(image, "no frame at this instant", (12, panel.height_px // 2), (160, 160, 160))
        else:
            exposed_ns, frame = found
            image = np.asarray(cv2.resize(frame, (panel.width_px, panel.height_px), interpolation=cv2.INTER_AREA))
            if self._spec.boxes and len(drawn.boxes):
                boxes, width = drawn.boxes_at(exposed_ns), 2 if panel.width_px > _WIDE_PX else 1
                image = draw_boxes(image, self._rig[camera_id], boxes, drawn.line_colours, thickness_px=width)
        label(image, camera_id)
        return image

    def _frame_near(self, camera_id: str, time_ns: int) -> tuple[int, Image] | None:
        times, sets = self._frames[camera_id]
        if not len(times):
            return None
        at = int(np.searchsorted(times, time_ns))
        nearest = min(range(max(at - 1, 0), min(at + 1, len(times))), key=lambda i: abs(int(times[i]) - time_ns))
        if abs(int(times[nearest]) - time_ns) > _NEAR_NS:
            return None
        return int(times[nearest]), self._store.image(camera_id, sets[nearest].time_ns)

    # --- the words -------------------------------------------------------------------------------
    def _strip(self, moment: Moment) -> Image:
        strip: Image = np.full((self._layout.strip.height_px, self._layout.strip.width_px, 3), _PAPER, dtype=np.uint8)
        seconds = moment.time_ns / 1e9
        words = f"{int(seconds // 60)}:{seconds % 60:04.1f}"
        words += f"   {len(moment.tracks)} road users" if len(moment.tracks) != 1 else "   1 road user"
        words += "" if self._spec.speed == 1 else f"   {self._spec.speed:g} x speed"
        write(strip, words, (14, strip.shape[0] // 2 + 6), scale=0.6)
        legend(strip, self._legend, 330)
        return strip

    @cached_property
    def _legend(self) -> list[tuple[str, Bgr]]:
        entries: list[tuple[str, Bgr]] = []
        if self._spec.colour == "class":
            present = {track.vehicle_class for moment in self._moments for track in moment.tracks}
            entries = [(item.value, bgr(item.traits.colour)) for item in sorted(present, key=lambda one: one.number)]
        if self._spec.colour == "speed":
            entries = [(f"{v:g} m/s", speed_colour(v)) for v in np.linspace(0, FASTEST_MPS, 5)]
        return [*entries, ("conflict", ALERT)] if self._conflicts else entries


def _put(whole: Image, panel: Panel, image: Image) -> None:
    whole[panel.y_px : panel.y_px + panel.height_px, panel.x_px : panel.x_px + panel.width_px] = image
