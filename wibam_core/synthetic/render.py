"""The renderer: painter's algorithm with OpenCV polygons, and exact truth from an id mask.

Still things come from a cached `Background`. Vehicles are painted from far to near; whatever of a vehicle lies behind
something still is taken back to the background, so that poles, trees and buildings occlude it properly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import HEIGHT, LENGTH, SIZE, SIZE_XY, WIDTH, XY, XYZ, YAW, X, Y, footprints
from wibam_core.geometry.camera import Camera
from wibam_core.synthetic.background import Background
from wibam_core.synthetic.layout import Layout, SignalHead
from wibam_core.synthetic.lighting import Lighting
from wibam_core.synthetic.mesh import Mesh, paint_order
from wibam_core.synthetic.raster import NEAR_M, SHIFT, Image, View, clip_near, fill, fixed_point
from wibam_core.synthetic.vehicles import VehicleModel, vehicle_mesh

Array = NDArray[np.float64]

#: Vehicles lower than this in the image are painted without windows, lamps and hubs.
DETAIL_PX = 9.0
#: Silhouettes larger than this are counted at a smaller scale.
_LARGE_PX = 1_500_000
TYRE = (30.0, 30.0, 32.0)
HUB = (120.0, 120.0, 118.0)


@dataclass(frozen=True, eq=False)
class Drawing:
    """One rendered image with its truth, one row per vehicle given.

    Attributes:
        image: (H, W, 3) uint8 BGR, before camera electronics (see `lighting.develop`).
        ids: (H, W) uint8, 0 for the background and i + 1 for pixels that show vehicle i.
        visible_boxes: (N, 4) xyxy around the visible pixels; zeros where none is visible.
        amodal_boxes: (N, 4) xyxy around the whole silhouette, clipped to the image; zeros where it is out of view.
        visibility: (N,) visible pixels / all pixels of the silhouette, those beyond the image's border included.
    """

    image: Image
    ids: Image
    visible_boxes: Array
    amodal_boxes: Array
    visibility: Array

    @property
    def in_view(self) -> NDArray[np.bool_]:
        """(N,) vehicles whose silhouette reaches into the image, hidden or not."""
        return np.asarray(self.amodal_boxes[:, 2] > self.amodal_boxes[:, 0])


class Body:
    """One vehicle prepared for one view: points in the image, hulls, bounds."""

    def __init__(self, view: View, mesh: Mesh, box: Array) -> None:
        self.mesh, self.box = mesh, box
        c, s = np.cos(box[YAW]), np.sin(box[YAW])
        self.rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        self.cam = view.to_camera(mesh.points @ self.rotation.T + box[XYZ])
        self.eye = (view.eye - box[XYZ]) @ self.rotation
        depth = self.cam[:, 2]
        self.whole = bool((depth >= NEAR_M).all())
        self.hulls: list[Array] = []
        self.bounds: Array | None = None
        self.distance = float(np.hypot(box[X] - view.eye[0], box[Y] - view.eye[1]))
        if not (depth >= NEAR_M).any():
            return
        if self.whole:
            self.uv = view.pixels(self.cam)
            groups = [self.uv[part.hull] for part in mesh.parts]
            groups += [self.uv[np.concatenate(w[:2])] for w in mesh.wheels]
        else:
            groups = [_clipped_hull_points(view, self.cam[part.hull]) for part in mesh.parts]
            groups += [_clipped_hull_points(view, self.cam[np.concatenate(w[:2])]) for w in mesh.wheels]
        groups = [g for g in groups if len(g) >= 3]
        if not groups:
            return
        everything = np.concatenate(groups)
        self.hulls = [cv2.convexHull(g.astype(np.float32))[:, 0].astype(np.float64) for g in groups]
        self.bounds = np.concatenate([everything.min(axis=0), everything.max(axis=0)])

    def face(self, view: View, numbers: NDArray[np.int64]) -> Array:
        """A face's polygon in the image (M, 2)."""
        if self.whole:
            return np.asarray(self.uv[numbers])
        clipped = clip_near(self.cam[numbers])
        return view.pixels(clipped) if len(clipped) >= 3 else np.zeros((0, 2))


def _clipped_hull_points(view: View, points_cam: Array) -> Array:
    """Image points (M, 2) whose convex hull is that of the part of a convex body beyond the near plane."""
    front = points_cam[:, 2] >= NEAR_M
    inside, outside = points_cam[front], points_cam[~front]
    if not len(inside):
        return np.zeros((0, 2))
    if len(outside):
        share = (NEAR_M - outside[None, :, 2]) / (inside[:, None, 2] - outside[None, :, 2] + 1e-12)
        cut = outside[None] + (inside[:, None] - outside[None]) * share[..., None]
        inside = np.concatenate([inside, cut.reshape(-1, 3)])
    return view.pixels(inside)


class Renderer:
    """Renders one camera's view of one intersection.

    Args:
        layout, lighting: the scene.
        camera: any pinhole camera with OpenCV distortion, above the ground.
    """

    def __init__(self, layout: Layout, lighting: Lighting, camera: Camera) -> None:
        self.view = View(camera)
        self.background = self._still(layout, lighting)
        self._lighting = lighting

    def _still(self, layout: Layout, lighting: Lighting) -> Background:
        return Background(layout, lighting, self.view)

    def _mesh(self, model: VehicleModel) -> Mesh:
        return vehicle_mesh(model)

    def sees(self, head: SignalHead) -> bool:
        """Whether a signal head is turned to the camera, wholly in its picture, and hidden by nothing still."""
        return self.background.sees(head)

    def draw(
        self,
        models: Sequence[VehicleModel],
        boxes: Array,
        signals: Mapping[str, str],
    ) -> Drawing:
        """Render vehicles, given by looks and boxes (N, 7), under the given signal states (phase -> state).

        Raises:
            ValueError: for more than 254 vehicles, which the id mask cannot hold.
        """
        boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 7)
        if len(models) != len(boxes) or len(boxes) > 254:
            raise ValueError(f"{len(models)} vehicles with {len(boxes)} boxes; at most 254 can be drawn")
        view = self.view
        width, height = view.size
        lit, dark = self.background.images(signals)
        image = lit.copy()
        ids = np.zeros((height, width), np.uint8)
        near_view = view.may_see(boxes[:, None, XYZ], np.linalg.norm(boxes[:, SIZE], axis=1) / 2)
        bodies = {i: Body(view, self._mesh(models[i]), boxes[i]) for i in np.flatnonzero(near_view).tolist()}
        seen = [i for i, body in bodies.items() if _reaches_into(body.bounds, width, height)]
        self._cast_shadows(image, dark, boxes)
        totals = np.zeros(len(boxes))
        for i in _far_to_near(boxes, bodies, seen, view.eye):
            totals[i] = self._paint(image, ids, lit, bodies[i], i + 1)
        amodal = np.zeros((len(boxes), 4))
        visible = np.zeros((len(boxes), 4))
        visibility = np.zeros(len(boxes))
        limits = np.array([width - 0.5, height - 0.5])
        counts = np.bincount(ids.ravel(), minlength=len(boxes) + 1)
        for i in seen:
            bounds = bodies[i].bounds
            assert bounds is not None
            amodal[i] = np.concatenate([np.maximum(bounds[:2], -0.5), np.minimum(bounds[2:], limits)])
            if counts[i + 1]:
                visible[i] = _visible_box(ids, i + 1, amodal[i])
                visibility[i] = min(1.0, counts[i + 1] / max(totals[i], 1.0))
        return Drawing(image, ids, visible, amodal, visibility)

    # --- shadows ----------------------------------------------------------------------------
    def _cast_shadows(self, image: Image, dark: Image, boxes: Array) -> None:
        cv2.copyTo(dark, self._shadow_mask(boxes), image)

    def _shadow_mask(self, boxes: Array) -> Image:
        """(H, W) 255 where vehicles keep the sun from the ground."""
        width, height = self.view.size
        mask = np.zeros((height, width), np.uint8)
        sun = np.array(self._lighting.sun)
        if self._lighting.shadow > 0.85:  # overcast: only the ground right below is dark
            sun = np.array([0.0, 0.0, 1.0])
        towards = sun[:2] / sun[2]
        near = np.hypot(*(boxes[:, XY] - self.view.eye[:2]).T) < 90
        near &= self.view.may_see(boxes[:, None, XYZ], 5.0 * boxes[:, HEIGHT])
        if not near.any():
            return mask
        b = boxes[near]
        rings = []
        for share, z in ((0.98, 0.15), (0.95, 0.62), (0.72, 1.0)):
            narrowed = b * np.array([1, 1, 1, share, share, 1, 1])
            rings.append(footprints(narrowed) - (towards * z * b[:, HEIGHT, None])[:, None])
        hulls = [cv2.convexHull(points)[:, 0] for points in np.concatenate(rings, axis=1).astype(np.float32)]
        for polygon in self.view.polygons([np.pad(h.astype(np.float64), ((0, 0), (0, 1))) for h in hulls]):
            fill(mask, polygon, (255,))
        return mask

    # --- vehicles ---------------------------------------------------------------------------
    def _paint(self, image: Image, ids: Image, still: Image, body: Body, number: int) -> float:
        """Paint one vehicle; returns the number of pixels of its whole silhouette."""
        assert body.bounds is not None
        x0, y0, x1, y1 = _patch(body.bounds, ids.shape[1], ids.shape[0])
        part = np.s_[y0:y1, x0:x1]
        total, mask = _silhouette(body, (x0, y0, x1, y1))
        self._paint_faces(image, body)
        np.copyto(ids[part], number, where=mask > 0)
        self._hide_behind_still(image[part], ids[part], still[part], mask, body, (x0, y0))
        return total

    def _paint_faces(self, image: Image, body: Body) -> None:
        mesh = body.mesh
        facing = np.einsum("ij,ij->i", mesh.normals, body.eye - mesh.centres) > 0
        assert body.bounds is not None
        detailed = body.bounds[3] - body.bounds[1] > DETAIL_PX
        if not detailed:
            facing &= ~mesh.detail
        light = self._lighting.shade(mesh.normals @ body.rotation.T)
        glow = mesh.glow
        colours = (mesh.colours * (glow + (1 - glow) * light)[:, None]).clip(0, 255).tolist()
        wheels = [cv2.convexHull(h.astype(np.float32))[:, 0] for h in self._wheel_outlines(body)]
        for outline in wheels:
            fill(image, outline, TYRE)
        pixels = fixed_point(body.uv) if body.whole else None
        for number in paint_order(mesh.order, body.eye):
            for f in mesh.parts[number].faces:
                if not facing[f]:
                    continue
                if pixels is not None:
                    cv2.fillConvexPoly(image, pixels[mesh.faces[f]], colours[f], cv2.LINE_8, SHIFT)
                else:
                    fill(image, body.face(self.view, mesh.faces[f]), colours[f])
        for outer, _, side in mesh.wheels:
            if body.eye[1] * side <= body.box[WIDTH] / 2:
                continue
            disc = body.face(self.view, outer)
            fill(image, disc, TYRE)
            if detailed and len(disc):
                middle = disc.mean(axis=0)
                fill(image, middle + 0.55 * (disc - middle), HUB)

    def _wheel_outlines(self, body: Body) -> list[Array]:
        if body.whole:
            return [body.uv[np.concatenate([outer, inner])] for outer, inner, _ in body.mesh.wheels]
        groups = [_clipped_hull_points(self.view, body.cam[np.concatenate(w[:2])]) for w in body.mesh.wheels]
        return [g for g in groups if len(g) >= 3]

    def _hide_behind_still(
        self, image: Image, ids: Image, still: Image, mask: Image, body: Body, corner: tuple[int, int]
    ) -> None:
        """Give pixels back to still things in front of the vehicle. All arrays are the vehicle's patch."""
        h, w = mask.shape
        occluders = self.background.occluders[corner[1] : corner[1] + h, corner[0] : corner[0] + w]
        radius = float(np.hypot(body.box[LENGTH], body.box[WIDTH])) / 2
        hidden = (occluders < body.distance + radius) & (mask > 0)
        if not hidden.any():
            return
        unsure = hidden & (occluders > body.distance - radius)
        if unsure.any():
            rows, columns = np.nonzero(unsure)
            rays = self.view.rays[:2, rows + corner[1], columns + corner[0]].astype(np.float64)
            entry = _entry_distance(rays / np.hypot(rays[0], rays[1]), body, self.view.eye)
            hidden[rows, columns] = occluders[rows, columns] < entry
        hidden8 = hidden.astype(np.uint8)
        cv2.copyTo(still, hidden8, image)
        ids[hidden] = 0


def _entry_distance(directions: Array, body: Body, eye: Array) -> Array:
    """Horizontal distance (M,) at which rays with ground directions (2, M) enter the vehicle's footprint.

    Rays that pass beside the footprint count as entering at its centre's distance.
    """
    local = body.rotation[:2, :2].T @ directions
    origin = body.eye[:2]
    half = body.box[SIZE_XY] / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (-half[:, None] - origin[:, None]) / local
        b = (half[:, None] - origin[:, None]) / local
    entry = np.nanmax(np.minimum(a, b), axis=0)
    leave = np.nanmin(np.maximum(a, b), axis=0)
    return np.where((entry <= leave) & (entry > 0), entry, body.distance)


def _reaches_into(bounds: Array | None, width: int, height: int) -> bool:
    if bounds is None:
        return False
    return bool(bounds[2] > -0.5 and bounds[3] > -0.5 and bounds[0] < width - 0.5 and bounds[1] < height - 0.5)


def _patch(bounds: Array, width: int, height: int) -> tuple[int, int, int, int]:
    """The image patch (x0, y0, x1, y1), ends exclusive, that holds everything painted within the bounds."""
    x0, y0 = np.floor(bounds[:2]).astype(int) - 1
    x1, y1 = np.ceil(bounds[2:]).astype(int) + 2
    return max(0, int(x0)), max(0, int(y0)), min(width, int(x1)), min(height, int(y1))


def _silhouette(body: Body, patch: tuple[int, int, int, int]) -> tuple[float, Image]:
    """Pixels of the whole silhouette, and the silhouette within the image patch (h, w)."""
    assert body.bounds is not None
    x0, y0, x1, y1 = patch
    low = np.floor(body.bounds[:2]).astype(int) - 1
    size = np.ceil(body.bounds[2:]).astype(int) + 2 - low
    if size[0] * size[1] <= _LARGE_PX:
        whole = np.zeros((int(size[1]), int(size[0])), np.uint8)
        for hull in body.hulls:
            fill(whole, hull - low, (1,))
        inside = whole[y0 - low[1] : y1 - low[1], x0 - low[0] : x1 - low[0]]
        return float(cv2.countNonZero(whole)), inside
    inside = np.zeros((y1 - y0, x1 - x0), np.uint8)
    for hull in body.hulls:
        fill(inside, hull - [x0, y0], (1,))
    scale = float(np.sqrt(_LARGE_PX / 10 / (float(size[0]) * float(size[1]))))
    small = np.zeros((int(size[1] * scale) + 1, int(size[0] * scale) + 1), np.uint8)
    for hull in body.hulls:
        fill(small, (hull - low) * scale, (1,))
    return max(cv2.countNonZero(small) / scale**2, float(cv2.countNonZero(inside))), inside


def _visible_box(ids: Image, number: int, amodal: Array) -> Array:
    """Tight xyxy box of the pixels that show vehicle ``number``, always inside its amodal box.

    The rasteriser paints every pixel that an outline touches, so the centres of the outermost pixels are the best
    estimate of the sides; a side within a pixel of the amodal box's is not hidden and takes its exact place.
    """
    x0, y0, x1, y1 = _patch(amodal, ids.shape[1], ids.shape[0])
    x, y, w, h = cv2.boundingRect((ids[y0:y1, x0:x1] == number).astype(np.uint8))
    box = np.array([x0 + x, y0 + y, x0 + x + w - 1, y0 + y + h - 1], dtype=np.float64)
    box = np.where(np.abs(box - amodal) <= 1.0, amodal, box)
    return np.concatenate([np.clip(box[:2], amodal[:2], amodal[2:]), np.clip(box[2:], amodal[:2], amodal[2:])])


def _far_to_near(boxes: Array, bodies: Mapping[int, Body], seen: list[int], eye: Array) -> list[int]:
    """The vehicles in ``seen`` in painter's order.

    Two upright convex bodies that do not meet are parted by an upright plane along a side of one of them; the one on
    the camera's side of that plane cannot be hidden by the other.
    """
    if len(seen) < 2:
        return seen
    b = boxes[seen]
    n = len(b)
    c, s = np.cos(b[:, YAW]), np.sin(b[:, YAW])
    to_local = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], axis=-2)
    half = b[:, SIZE_XY] / 2
    corners = footprints(b)
    others = np.einsum("iab,ijkb->ijka", to_local, corners[None] - b[:, None, None, XY])
    viewer = np.einsum("iab,ib->ia", to_local, eye[:2] - b[:, XY])
    front = np.zeros((n, n), bool)  # front[i, j]: i must be painted after j
    decided = np.eye(n, dtype=bool)
    for axis in (0, 1):
        for sign in (1, -1):
            apart = (sign * others[..., axis]).min(axis=2) >= half[:, None, axis] - 1e-6
            i_is_near = (sign * viewer[:, axis] <= half[:, axis])[:, None]
            new = apart & ~decided
            front |= new & i_is_near
            front.T[new & ~i_is_near] = True
            decided |= apart | apart.T
    bounds = np.array([bodies[i].bounds for i in seen])
    meet = (bounds[:, None, :2] <= bounds[None, :, 2:]).all(-1)
    front &= meet & meet.T
    distance = np.array([bodies[i].distance for i in seen])
    order: list[int] = []
    remaining = list(np.argsort(-distance))
    while remaining:
        free = next((i for i in remaining if not front[i, remaining].any()), remaining[0])
        order.append(seen[free])
        remaining.remove(free)
    return order
