"""The renderer of varied training views: materials, gradients of light, reflections and soft shadows.

Truth is that of `Renderer`: silhouettes and what hides them are the same, only colours differ.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.geometry.box3d import LENGTH, WIDTH, footprints
from wibam_core.geometry.camera import Camera
from wibam_core.synthetic.layout import Layout
from wibam_core.synthetic.lighting import Lighting
from wibam_core.synthetic.mesh import Colour, Mesh, paint_order
from wibam_core.synthetic.raster import Image, fill
from wibam_core.synthetic.render import DETAIL_PX, HUB, TYRE, Body, Renderer
from wibam_core.synthetic.shapes import lift
from wibam_core.synthetic.textured_background import Materials, TexturedBackground
from wibam_core.synthetic.textures import TILE_PX, Field
from wibam_core.synthetic.varied_vehicles import VariedModel, varied_mesh
from wibam_core.synthetic.vehicles import VehicleModel, vehicle_mesh

Array = NDArray[np.float64]

#: Faces smaller than this in the image are painted in one colour, px².
_SHADED_PX2 = 30
#: Dark details without light of their own are glass or plastic, which mirrors more than paint.
_DARK_LEVEL = 100.0


@dataclass(frozen=True)
class _Gloss:
    """How one vehicle's surfaces take light: all in shares of a colour.

    Attributes:
        slope: brighter above, darker below. sky: mirrored from above on flat faces. pane: mirrored in glass.
        edge: height at which what glass mirrors changes from sky to ground, 0 below to 1 above.
        dirt: darkening towards the ground. grain: unevenness. light: of the whole vehicle, below 1 in a shadow.
        corner: where in the noise its own begins. hub: size and colour of what is in the middle of wheels.
    """

    slope: float
    sky: float
    pane: float
    edge: float
    dirt: float
    grain: float
    light: float
    corner: tuple[int, int]
    hub: tuple[float, Colour]

    @classmethod
    def of(cls, rng: np.random.Generator) -> _Gloss:
        x, y = rng.integers(0, TILE_PX, 2).tolist()
        hub = (float(rng.uniform(0.4, 0.8)), (float(rng.uniform(30, 210)),) * 3 if rng.random() < 0.8 else HUB)
        return cls(
            slope=float(rng.uniform(-0.1, 0.5)),
            sky=float(rng.beta(1.2, 2.0) * 0.6),
            pane=float(rng.beta(1.2, 1.5)),
            edge=float(rng.uniform(-0.2, 1.2)),
            dirt=float(rng.beta(1.0, 4.0) * 0.7),
            grain=float(rng.uniform(0.0, 0.09)),
            light=float(rng.uniform(0.55, 0.9) if rng.random() < 0.2 else rng.uniform(0.85, 1.15)),
            corner=(x, y),
            hub=hub,
        )


class TexturedRenderer(Renderer):
    """Renders one camera's view of one intersection that is made of ``materials``."""

    def __init__(self, layout: Layout, lighting: Lighting, camera: Camera, materials: Materials) -> None:
        self._materials = materials
        self._noise: Field = np.tile(materials.noise[0], (3, 4)) * 0.6 + np.tile(materials.noise[1], (3, 4)) * 0.4
        rng = np.random.default_rng([materials.seed, 3])
        self._contact, self._contact_px = float(rng.uniform(0.25, 0.85)), float(rng.uniform(0.5, 3.0))
        super().__init__(layout, lighting, camera)

    def _still(self, layout: Layout, lighting: Lighting) -> TexturedBackground:
        self._textured = TexturedBackground(layout, lighting, self.view, self._materials)
        return self._textured

    def _mesh(self, model: VehicleModel) -> Mesh:
        return varied_mesh(model) if isinstance(model, VariedModel) else vehicle_mesh(model)

    def _cast_shadows(self, image: Image, dark: Image, boxes: Array) -> None:
        """The sun's, as soft as those of still things, and the darkness below each vehicle."""
        share = self._shadow_mask(boxes).astype(np.float32) / 255
        if self._textured.softness_px:
            share = cv2.GaussianBlur(share, (0, 0), self._textured.softness_px)
        darker = image + (dark.astype(np.float32) - image) * share[..., None]
        below = np.zeros(image.shape[:2], np.uint8)
        for outline in self.view.polygons([lift(ring) for ring in footprints(boxes)]):
            fill(below, outline, (255,))
        contact = cv2.GaussianBlur(below, (0, 0), self._contact_px).astype(np.float32) / 255
        image[:] = (darker * (1 - (1 - self._contact) * contact)[..., None]).clip(0, 255)

    def _paint_faces(self, image: Image, body: Body) -> None:
        mesh = body.mesh
        gloss = _Gloss.of(np.random.default_rng(int(body.box[LENGTH] * 1e7)))
        facing = np.einsum("ij,ij->i", mesh.normals, body.eye - mesh.centres) > 0
        assert body.bounds is not None
        detailed = body.bounds[3] - body.bounds[1] > DETAIL_PX
        if not detailed:
            facing &= ~mesh.detail
        normals = mesh.normals @ body.rotation.T
        light = self._lighting.shade(normals) * gloss.light
        colours = (mesh.colours * (mesh.glow + (1 - mesh.glow) * light)[:, None]).clip(0, 255)
        for outline in self._wheel_outlines(body):
            fill(image, cv2.convexHull(outline.astype(np.float32))[:, 0], TYRE)
        for number in paint_order(mesh.order, body.eye):
            for f in mesh.parts[number].faces:
                if not facing[f]:
                    continue
                outline = body.face(self.view, mesh.faces[f])
                if mesh.glow[f] > 0:
                    fill(image, outline, colours[f].tolist())
                    continue
                pane = bool(mesh.detail[f]) and mesh.colours[f].max() < _DARK_LEVEL
                self._paint_face(image, outline, colours[f], gloss, float(normals[f, 2]), pane)
        self._paint_wheels(image, body, gloss, detailed)

    def _paint_face(
        self, image: Image, outline: Array, colour: Array, gloss: _Gloss, upward: float, pane: bool
    ) -> None:
        """One face: its colour, brighter above, mixed with the sky, dirty below."""
        if len(outline) < 3:
            return
        low = np.floor(outline.min(axis=0)).astype(int) - 1
        high = np.ceil(outline.max(axis=0)).astype(int) + 2
        x0, y0 = np.maximum(low, 0).tolist()
        x1, y1 = np.minimum(high, self.view.size).tolist()
        if x0 >= x1 or y0 >= y1:
            return
        if (x1 - x0) * (y1 - y0) < _SHADED_PX2:
            fill(image, outline, colour.tolist())
            return
        mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
        fill(mask, outline - [x0, y0], (1,))
        down = ((np.arange(y0, y1) - low[1]) / max(high[1] - low[1], 1)).astype(np.float32)[:, None]
        row, column = gloss.corner[1], gloss.corner[0]
        noise = self._noise[row : row + y1 - y0, column : column + x1 - x0]
        field = 1 + np.float32(gloss.slope) * (np.float32(0.5) - down) - np.float32(gloss.dirt) * down**4
        field = field + np.float32(gloss.grain) * noise
        if pane:
            seen = 1 / (1 + np.exp(np.float32(14) * (down - np.float32(gloss.edge)) + noise))
            share = np.float32(0.75 * gloss.pane) * seen
        else:
            share = np.float32(gloss.sky * max(upward, 0.0)) * (1 + np.float32(0.4) * noise)
        share = np.broadcast_to(share, mask.shape).clip(0, 0.9)[..., None]
        sky = np.array(self._lighting.sky_top, np.float32)
        shown = colour.astype(np.float32) * field[..., None] * (1 - share) + sky * share
        cv2.copyTo(np.asarray(shown.clip(0, 255), np.uint8), mask, image[y0:y1, x0:x1])

    def _paint_wheels(self, image: Image, body: Body, gloss: _Gloss, detailed: bool) -> None:
        for outer, _, side in body.mesh.wheels:
            if body.eye[1] * side <= body.box[WIDTH] / 2:
                continue
            disc = body.face(self.view, outer)
            if not len(disc):
                continue
            middle = disc.mean(axis=0)
            fill(image, disc, TYRE)
            if detailed:
                size, colour = gloss.hub
                fill(image, middle + size * (disc - middle), colour)
                fill(image, middle + 0.4 * size * (disc - middle), tuple(0.5 * c for c in colour))
