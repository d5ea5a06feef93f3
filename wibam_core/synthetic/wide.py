"""Pictures of wide lenses, put together from pinhole renderings.

The renderer fills polygons with straight sides. Around a wide lens therefore stand pinholes, the faces of a cube, each
rendered by itself; every pixel of the wide picture is taken from the face that its ray meets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import XYZ, YAW
from wibam_core.geometry.camera import Camera
from wibam_core.geometry.cut_view import CutView
from wibam_core.site import Lens
from wibam_core.synthetic.cameras import heads_in_view
from wibam_core.synthetic.layout import Layout, SignalHead
from wibam_core.synthetic.lighting import Lighting
from wibam_core.synthetic.raster import Image
from wibam_core.synthetic.render import Drawing, Renderer
from wibam_core.synthetic.vehicles import VehicleModel, vehicle_mesh

Array = NDArray[np.float64]

#: Faces reach a little beyond their 90 degrees, so that pixels at their edges have neighbours.
_FACE_DEG = 92.0
#: A face has this many pixels for one of the picture's, along each axis, in its middle.
_FINER = 1.2
#: Focal lengths in image widths: 150 to 170 degrees across for a fisheye, about the same for xi around 1.
_FOCAL: dict[Lens, tuple[float, float]] = {"fisheye": (0.34, 0.38), "omnidirectional": (0.60, 0.68)}
#: Sides of faces are bent into curves of so many pieces.
_PIECES = 6
#: Columns are the axes x, y, z of each face in the camera's frame.
_FACES = [
    np.array(axes, dtype=np.float64).T
    for axes in (
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
        ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
        ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
        ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
        ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    )
]


def with_lens(camera: Camera, lens: Lens, rng: np.random.Generator) -> Camera:
    """A pinhole camera's place and direction with a wide lens of random coefficients; a pinhole stays as it is."""
    if lens == "pinhole":
        return camera
    focal = float(rng.uniform(*_FOCAL[lens])) * camera.width_px
    K = np.array([[focal, 0, camera.K[0, 2]], [0, focal, camera.K[1, 2]], [0, 0, 1]])
    if lens == "fisheye":
        dist, xi = rng.normal(0, [0.02, 0.005, 0.001, 0.0002]), 0.0
    else:
        dist, xi = rng.normal(0, [0.02, 0.005, 5e-4, 5e-4]), float(rng.uniform(0.8, 1.2))
    return replace(camera, K=K, dist=dist, lens=lens, xi=xi)


class WideRenderer:
    """Renders one wide lens's view of one intersection, as `Renderer` does a pinhole's.

    Args:
        layout, lighting: the scene.
        camera: with a wide lens, above the ground.
    """

    def __init__(self, layout: Layout, lighting: Lighting, camera: Camera) -> None:
        self.camera = camera
        u, v = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
        rays = camera.rays(np.stack([u, v], axis=-1)) @ camera.T_world_cam.rotation  # in the camera's frame
        towards = np.stack([rays @ face[:, 2] for face in _FACES])
        nearest = np.where(np.isfinite(towards).all(axis=0), towards.argmax(axis=0), -1)
        size = round(_FINER * _px_per_rad(camera) * 2 * float(np.tan(np.radians(_FACE_DEG) / 2)))
        focal = size / 2 / np.tan(np.radians(_FACE_DEG) / 2)
        K = np.array([[focal, 0, (size - 1) / 2], [0, focal, (size - 1) / 2], [0, 0, 1]])
        used = [number for number in range(len(_FACES)) if (nearest == number).any()]
        self._size = size
        self._faces = [Renderer(layout, lighting, CutView("", _FACES[n], K, size, size).camera(camera)) for n in used]
        #: Where in the faces, one below the other, each pixel is found; nowhere where the lens shows nothing.
        where = np.full((*nearest.shape, 2), -10.0)
        for place, number in enumerate(used):
            mine = nearest == number
            local = rays[mine] @ _FACES[number]
            where[mine] = local[:, :2] / local[:, 2:] * focal + K[:2, 2] + [0, place * size]
        self._where = where.astype(np.float32)
        columns, rows = np.rint(where[nearest >= 0]).astype(int).T
        self._shown = np.zeros((len(used) * size, size), bool)
        self._shown[np.clip(rows, 0, len(used) * size - 1), np.clip(columns, 0, size - 1)] = True
        self._shown = cv2.dilate(self._shown.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0

    def sees(self, head: SignalHead) -> bool:
        """Whether a signal head is turned to the camera, wholly in its picture, and hidden by nothing still."""
        in_picture = bool(heads_in_view(self.camera, [head])[0])
        return in_picture and any(face.background.sees(head) for face in self._faces)

    def draw(self, models: Sequence[VehicleModel], boxes: Array, signals: Mapping[str, str]) -> Drawing:
        """See `Renderer.draw`. The visible share of a vehicle is the sum of those of the faces that show it."""
        boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 7)
        drawn = [face.draw(models, boxes, signals) for face in self._faces]
        image = self._taken(np.concatenate([one.image for one in drawn]), cv2.INTER_LINEAR)
        faces = np.concatenate([one.ids for one in drawn])
        ids = self._taken(faces, cv2.INTER_NEAREST)
        amodal, visible, visibility = np.zeros((len(boxes), 4)), np.zeros((len(boxes), 4)), np.zeros(len(boxes))
        for place, one in enumerate(drawn):
            rows = slice(place * self._size, (place + 1) * self._size)
            painted = np.bincount(one.ids.ravel(), minlength=len(boxes) + 1)[1:]
            in_picture = np.bincount(one.ids[self._shown[rows]], minlength=len(boxes) + 1)[1:]
            visibility += one.visibility * in_picture / np.maximum(painted, 1)
        limits = np.array([self.camera.width_px, self.camera.height_px]) - 0.5
        for i, model in enumerate(models):
            bounds = self._bounds(model, boxes[i])
            if bounds is None or (bounds[2:] <= -0.5).any() or (bounds[:2] >= limits).any():
                visibility[i] = 0.0
                continue
            amodal[i] = np.concatenate([np.maximum(bounds[:2], -0.5), np.minimum(bounds[2:], limits)])
            x, y, w, h = cv2.boundingRect((ids == i + 1).astype(np.uint8))
            if w and h:
                outline = np.array([x, y, x + w - 1, y + h - 1], dtype=np.float64)
                outline = np.where(np.abs(outline - amodal[i]) <= 1.0, amodal[i], outline)
                visible[i] = np.clip(outline, np.tile(amodal[i, :2], 2), np.tile(amodal[i, 2:], 2))
            else:
                visibility[i] = 0.0
        return Drawing(image, ids, visible, amodal, np.minimum(visibility, 1.0))

    def _taken(self, faces: Image, interpolation: int) -> Image:
        picture = cv2.remap(faces, self._where, None, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray(picture, dtype=np.uint8)

    def _bounds(self, model: VehicleModel, box: Array) -> Array | None:
        """xyxy (4,) around the whole silhouette, border or not; None where nothing of it is seen."""
        mesh = vehicle_mesh(model)
        c, s = np.cos(box[YAW]), np.sin(box[YAW])
        points = self.camera.to_camera(mesh.points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) + box[XYZ])
        outlines = [
            points[numbers] for numbers in (*mesh.faces, *(disc for wheel in mesh.wheels for disc in wheel[:2]))
        ]
        starts = np.concatenate(outlines)
        ends = np.concatenate([np.roll(outline, -1, axis=0) for outline in outlines])
        share = np.linspace(0, 1, _PIECES + 1)[:, None, None]
        along = ((1 - share) * starts + share * ends).reshape(-1, 3)
        seen = along[self.camera.sees(along)]
        if not len(seen):
            return None
        pixels = self.camera.project_camera_points(seen)
        return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def _px_per_rad(camera: Camera) -> float:
    """How many pixels make a radian in the middle of the picture."""
    step_rad = 1e-4
    pixels = camera.project_camera_points(np.array([[0.0, 0.0, 1.0], [step_rad, 0.0, 1.0]]))
    return float(np.linalg.norm(pixels[1] - pixels[0]) / step_rad)
