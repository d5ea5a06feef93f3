"""The still part of a view with materials: ground, houses, trees, sky and shadows as varied as a generator can.

What is where, and what hides what, is decided by `Background`; only what surfaces look like is decided here.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.background import Background
from wibam_core.synthetic.facades import Facade, Kind, facade, sample_surfaces
from wibam_core.synthetic.layout import Building, Layout, Tree
from wibam_core.synthetic.lighting import Lighting
from wibam_core.synthetic.raster import Image, View, fill, fill_any
from wibam_core.synthetic.shapes import lift, upright
from wibam_core.synthetic.textures import (
    TILE_PX,
    Field,
    Texture,
    asphalt,
    foliage,
    fractal,
    grass,
    gravel,
    paving,
    sample_texture,
    wrapped,
)

Array = NDArray[np.float64]

#: Grey levels by which kinds of ground are told apart while they are laid out.
_ROAD, _WALK, _TERRAIN, _PAINT = 50, 100, 150, 225
_BAY = 56  # a parking bay is painted 1.12 times as bright as the road
_FAR_M = 400.0


@dataclass(frozen=True, eq=False)
class Materials:
    """What one intersection is made of.

    Attributes:
        road, bay, walk, terrain, leaves: textures. noise: (S, S) fields of mean 0 and s.d. 1.
        paint: BGR of road markings, and of the few that are not white. worn: 0 fresh to 1 mostly gone.
        extra: (N, 4, 2) further markings on the ground, and whether each has the second colour.
        surfaces: of walls. seed: of all that is drawn for one wall, tree or view.
        walls: those that were painted before, by building and side.
    """

    road: Texture
    bay: Texture
    walk: Texture
    terrain: Texture
    leaves: tuple[Texture, ...]
    noise: tuple[Field, Field]
    paint: tuple[Array, Array]
    worn: float
    extra: tuple[tuple[Array, bool], ...]
    surfaces: dict[Kind, list[Field]]
    seed: int
    walls: dict[tuple[int, int], Facade] = field(default_factory=dict)


def sample_materials(layout: Layout, rng: np.random.Generator) -> Materials:
    """Materials for a layout."""
    return Materials(
        road=sample_texture(rng, asphalt, asphalt, asphalt, gravel),
        bay=sample_texture(rng, asphalt, paving),
        walk=sample_texture(rng, paving, paving, asphalt, gravel, grass),
        terrain=sample_texture(rng, grass, grass, gravel, paving, asphalt),
        leaves=tuple(Texture.of(foliage(rng), float(rng.uniform(2, 6))) for _ in range(3)),
        noise=(fractal(rng, 4, 0.65), fractal(rng, 16, 0.8)),
        paint=(
            rng.uniform(170, 250) * np.array([rng.uniform(0.85, 1.0), rng.uniform(0.93, 1.0), 1.0]),
            np.array([rng.uniform(20, 110), rng.uniform(110, 200), rng.uniform(170, 245)]),
        ),
        worn=float(rng.beta(1.2, 2.0)),
        extra=tuple(_extra_markings(layout, rng)),
        surfaces=sample_surfaces(rng),
        seed=int(rng.integers(2**31)),
    )


def _extra_markings(layout: Layout, rng: np.random.Generator) -> list[tuple[Array, bool]]:
    """Arrows, bars, hatches and lines on the lanes."""
    found: list[tuple[Array, bool]] = []
    for arm in layout.arms:
        second = bool(rng.random() < 0.3)
        for lane in range(arm.incoming):
            middle = arm.lane_lateral_m(lane, True)
            for along in arm.stop_m + np.array([rng.uniform(3, 12), rng.uniform(18, 35)]):
                if rng.random() < 0.6:  # an arrow: a shaft and a head
                    found.append((arm.strip(along, along + 2.5, middle - 0.09, middle + 0.09), False))
                    tip = arm.point(
                        [along - 1.3, along, along, along - 1.3], [middle, middle + 0.5, middle - 0.5, middle]
                    )
                    found.append((tip, False))
        if rng.random() < 0.4:  # a second line beside the middle
            found.append((arm.strip(arm.stop_m, arm.length_m, 0.15, 0.30), second))
        if rng.random() < 0.3:  # hatches
            for along in np.arange(arm.stop_m + 2, arm.stop_m + 30, rng.uniform(0.8, 2.5)):
                found.append((arm.strip(along, along + 0.4, -0.9, 0.9), second))
        if rng.random() < 0.25:
            edge = arm.in_edge_m
            found.append((arm.strip(arm.stop_m + 8, arm.stop_m + 40, edge - 0.6, edge - 0.45), True))
    for _ in range(int(rng.integers(0, 10))):  # boxes and bars anywhere
        centre, half = rng.uniform(-14, 14, 2), rng.uniform(0.05, [1.5, 0.4])
        angle = rng.uniform(0, np.pi)
        along = half[0] * np.array([np.cos(angle), np.sin(angle)])
        across = half[1] * np.array([-np.sin(angle), np.cos(angle)])
        corners = [centre - along - across, centre + along - across, centre + along + across, centre - along + across]
        found.append((np.array(corners), bool(rng.random() < 0.3)))
    return found


class TexturedBackground(Background):
    """A `Background` whose surfaces have the given materials.

    Attributes:
        softness_px: by how much the borders of shadows are blurred.
    """

    def __init__(self, layout: Layout, lighting: Lighting, view: View, materials: Materials) -> None:
        self._materials = materials
        self._rng = np.random.default_rng([materials.seed, int(abs(view.eye[0]) * 1000)])
        self.softness_px = float(self._rng.choice([0.0, 0.8, 2.0, 5.0]))
        down = np.minimum(view.rays[2], np.float32(-1e-4))
        self._below = view.rays[2] < -1e-4
        self._scale = np.minimum(np.float32(-view.eye[2]) / down, np.float32(_FAR_M))
        self._ground = tuple(np.float32(view.eye[i]) + self._scale * view.rays[i] for i in (0, 1))
        super().__init__(layout, lighting, view)

    # --- sky and ground ---------------------------------------------------------------------
    def _paint_sky(self, image: Image) -> None:
        """Clouds, and hills, woods or roofs along the horizon."""
        super()._paint_sky(image)
        view, rng = self._view, self._rng
        azimuth = np.arctan2(view.rays[1], view.rays[0])
        elevation = view.rays[2] / np.maximum(self._horizontal, np.float32(1e-6))
        noise = self._materials.noise[0]
        u = wrapped(azimuth * np.float32(TILE_PX / (2 * np.pi)), TILE_PX)
        v = wrapped(np.sqrt(elevation.clip(0, 4)) * np.float32(220), TILE_PX)
        clouds = cv2.remap(noise, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        share = ((clouds - np.float32(rng.normal(0.3, 0.8))) * np.float32(0.5)).clip(0, 0.8) * (elevation > 0)
        white = np.full_like(image, round(rng.uniform(150, 250)))
        _mix(image, white, share)
        round_about = np.tile(noise[:1], (1, 3))
        profile = cv2.GaussianBlur(round_about, (0, 0), float(rng.uniform(0.5, 8)))[0, TILE_PX : 2 * TILE_PX]
        height = np.float32(rng.uniform(0.0, 0.10)) * (1 + profile.clip(-1, 3))
        at = u.astype(np.int64) % TILE_PX
        hills = (elevation > -0.01) & (elevation < height[at])
        leaves = self._materials.leaves[0]
        shown = leaves.at(azimuth * 60, elevation * 60, np.full_like(azimuth, 0.15))
        _mix(shown, np.full_like(image, self._lighting.sky_horizon), np.full_like(azimuth, rng.uniform(0.1, 0.7)))
        cv2.copyTo(shown, hills.astype(np.uint8), image)
        cv2.copyTo(np.full_like(image, _TERRAIN), self._below.astype(np.uint8), image)

    def _paint_ground(self, image: Image) -> None:
        """Lay out kinds of ground as grey levels, then show the materials there."""
        true = self._layout
        self._layout = replace(true, asphalt=(_ROAD,) * 3, sidewalk=(_WALK,) * 3, terrain=(_TERRAIN,) * 3)
        kinds = np.full_like(image, _TERRAIN)
        super()._paint_ground(kinds)
        self._layout = true
        second = np.zeros(image.shape[:2], np.uint8)
        for quad, other in self._materials.extra:
            outline = self._view.polygon(lift(quad))
            fill(kinds, outline, (_PAINT,) * 3)
            if other:
                fill(second, outline, (1,))
        kind = kinds[..., 0]
        kind[~self._below] = 0
        materials = self._materials
        pixel_m = self._scale * np.float32(1 / self._view.camera.K[0, 0]) * np.sqrt(1 + self._scale / self._view.eye[2])
        pixel_m = np.asarray(pixel_m, np.float32)
        x, y = self._ground
        for material, numbers in (
            (materials.terrain, (_TERRAIN,)),
            (materials.walk, (_WALK,)),
            (materials.bay, (_BAY,)),
            (materials.road, (_ROAD, _PAINT)),
        ):
            there = np.isin(kind, numbers).astype(np.uint8)
            if cv2.countNonZero(there):
                cv2.copyTo(material.at(x, y, pixel_m), there, image)
        self._paint_kerbs(image, kind)
        noise = self._at_ground(materials.noise[1], 6.0)
        kept = (1.2 - materials.worn + 0.5 * noise).clip(0.1, 1) * (kind == _PAINT)
        for number, colour in enumerate(materials.paint):
            _mix(image, np.full_like(image, colour), np.asarray(kept * (second == number), np.float32))

    def _paint_kerbs(self, image: Image, kind: Image) -> None:
        """A bright or dark line where the road ends."""
        road = np.isin(kind, (_ROAD, _BAY, _PAINT)).astype(np.uint8)
        near = (self._scale * np.float32(1) < self._rng.uniform(8, 60)) & (kind > 0)
        edge = cv2.dilate(road, np.ones((3, 3), np.uint8)) - road
        shade = self._rng.uniform(60, 220)
        cv2.copyTo(np.full_like(image, shade), edge * near.astype(np.uint8), image)

    def _at_ground(self, noise: Field, tile_m: float) -> Field:
        """Noise (H, W) laid on the ground, a tile ``tile_m`` wide."""
        x, y = (wrapped(axis * np.float32(TILE_PX / tile_m), TILE_PX) for axis in self._ground)
        return np.asarray(cv2.remap(noise, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))

    def _texture_ground(self, image: Image) -> tuple[Image, Image]:
        """Patches, haze and shadows; returns the lit and the shadowed picture."""
        lighting, rng = self._lighting, self._rng
        broad = self._at_ground(self._materials.noise[0], float(rng.uniform(20, 90)))
        light = 1 + np.float32(rng.uniform(0.0, 0.12)) * broad
        distance = self._scale * self._horizontal
        clear = np.where(self._below, np.exp(-distance / np.float32(lighting.haze_m)), np.float32(1))
        light = np.where(self._below, light, np.float32(1)) * clear
        lit = _scaled(image, light)
        haze = (1 - clear)[..., None] * np.array(lighting.sky_horizon, np.float32)
        lit = cv2.add(lit, haze.astype(np.uint8))
        tint = np.array([1.06, 1.0, 0.95], np.float32) * np.float32(lighting.shadow)
        dim = np.where(self._below[..., None], 1 - clear[..., None] * (1 - tint), np.float32(1))
        dark = np.asarray((lit * dim).clip(0, 255), np.uint8)
        shadows = np.zeros(image.shape[:2], np.uint8)
        for polygon in self._view.polygons([lift(p) for p in [*self._still_shadows(), *self._shadows_from_outside()]]):
            fill_any(shadows, polygon, (255,))
        share = shadows.astype(np.float32) / 255
        if rng.random() < 0.4:  # under leaves
            leaves = self._at_ground(self._materials.noise[1], float(rng.uniform(4, 20)))
            where = self._at_ground(self._materials.noise[0], float(rng.uniform(30, 120)))
            dappled = (1.5 * leaves + 0.5).clip(0, 1) * (2 * where - rng.uniform(0, 2)).clip(0, 1)
            share = np.maximum(share, dappled)
        if self.softness_px:
            share = cv2.GaussianBlur(share, (0, 0), self.softness_px)
        result = lit.copy()
        _mix(result, dark, np.asarray(share, np.float32))
        return result, dark

    def _shadows_from_outside(self) -> list[Array]:
        """Long shadows of houses and masts that are not there."""
        if self._lighting.shadow > 0.9:
            return []
        rng, found = self._rng, []
        sun = np.array(self._lighting.sun[:2])
        along = -sun / (np.linalg.norm(sun) + 1e-9)
        across = np.array([-along[1], along[0]])
        for _ in range(int(rng.integers(0, 4))):
            foot, wide = rng.uniform(-30, 30, 2), rng.choice([0.15, 0.4, 3.0, 10.0]) * rng.uniform(0.5, 1.5)
            tip = foot + along * rng.uniform(4, 40)
            found.append(
                np.stack([foot - wide * across, foot + wide * across, tip + wide * across, tip - wide * across])
            )
        return found

    # --- upright things ---------------------------------------------------------------------
    def _paint_building(self, image: Image, building: Building) -> None:
        view = self._view
        seed = int(abs(building.footprint[0] @ [1000.0, 7919.0]))
        for i in range(4):
            a, b = building.footprint[i], building.footprint[(i + 1) % 4]
            length = float(np.linalg.norm(b - a))
            along = (b - a) / length
            normal = np.array([along[1], -along[0], 0.0])
            if normal[:2] @ (view.eye[:2] - a) <= 0:
                continue
            outline = view.polygon(upright(a, b, 0, building.height_m))
            if not len(outline):
                continue
            mask = np.zeros(image.shape[:2], np.uint8)
            fill_any(mask, outline, (1,))
            x, y, w, h = cv2.boundingRect(mask)
            if w == 0:
                continue
            part = np.s_[y : y + h, x : x + w]
            rays = [ray[part] for ray in view.rays]
            facing = np.float32(normal[0]) * rays[0] + np.float32(normal[1]) * rays[1]
            depth = np.float32(normal[:2] @ (a - view.eye[:2])) / np.minimum(facing, np.float32(-1e-6))
            np.copyto(self.occluders[part], depth * self._horizontal[part], where=mask[part] > 0)
            wall = self._wall(building, length, (seed, i % 2))
            offset = view.eye[:2] - a
            u = np.float32(offset @ along) + depth * (np.float32(along[0]) * rays[0] + np.float32(along[1]) * rays[1])
            z = np.float32(view.eye[2]) + depth * rays[2]
            shown = self._wall_pixels(wall.picture, wall.px_per_m, u, np.float32(building.height_m) - z, depth)
            light = float(self._lighting.shade(normal[None])[0])
            cv2.copyTo(np.asarray((shown * np.float32(light)).clip(0, 255), np.uint8), mask[part], image[part])
        if view.eye[2] > building.height_m:
            roof = view.polygon(lift(building.footprint, building.height_m))
            if len(roof):
                shade = np.random.default_rng(seed).uniform(50, 190)
                fill_any(image, roof, self._shaded((shade, shade, shade * 1.03), np.array([0.0, 0, 1])))
                distance = cv2.pointPolygonTest(
                    building.footprint.astype(np.float32), (float(view.eye[0]), float(view.eye[1])), True
                )
                fill_any(self.occluders, roof, (max(0.0, -distance),))

    def _wall(self, building: Building, length_m: float, which: tuple[int, int]) -> Facade:
        materials = self._materials
        if which not in materials.walls:
            rng = np.random.default_rng([materials.seed, *which])
            materials.walls[which] = facade(building, length_m, materials.surfaces, rng)
        return materials.walls[which]

    def _wall_pixels(self, picture: Image, px_per_m: float, u_m: Field, down_m: Field, depth: Field) -> Image:
        """A wall's picture at places u along it and down from its top; smaller copies are used for what is far."""
        pixel = float(np.median(depth)) / self._view.camera.K[0, 0] * px_per_m
        if pixel > 1.5:
            size = tuple(max(4, round(side / pixel)) for side in picture.shape[1::-1])
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
            px_per_m = px_per_m / pixel
        scale = np.float32(px_per_m)
        return np.asarray(
            cv2.remap(picture, u_m * scale, down_m * scale, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        )

    def _paint_tree(self, image: Image, tree: Tree, distance: float) -> None:
        """A crown of many lit and shadowed tufts."""
        rng = np.random.default_rng([self._materials.seed, abs(int(tree.x_m * 1000))])
        foot = np.array([tree.x_m, tree.y_m])
        side = self._sideways(tree.x_m, tree.y_m) * rng.uniform(0.08, 0.25)
        trunk = self._view.polygon(upright(foot - side, foot + side, 0, tree.height_m - 0.5 * tree.crown_m))
        fill(image, trunk, self._shaded((50.0, 65.0, 80.0), np.array([0.0, 0, 1])))
        fill(self.occluders, trunk, (distance,))
        stretch = rng.uniform([0.4, 0.4, 0.5], [0.8, 0.8, 1.3])
        tufts = rng.normal(0, 1, (int(rng.integers(60, 220)), 3)) * stretch * tree.crown_m * 0.75
        tufts = tufts[np.argsort(tufts[:, 2])]
        cam = self._view.to_camera(np.array([tree.x_m, tree.y_m, tree.height_m - tree.crown_m]) + tufts)
        if cam[:, 2].min() < 1.0:
            return
        uv = np.rint(self._view.pixels(cam)).astype(int)
        sizes = rng.uniform(0.06, 0.26, len(tufts)) * tree.crown_m * self._view.camera.K[0, 0] / cam[:, 2]
        light = 0.7 + 0.45 * (tufts @ np.array(self._lighting.sun) / tree.crown_m).clip(-1, 1)
        colours = np.array(tree.colour) * (light * rng.uniform(0.7, 1.3, len(tufts)))[:, None]
        for (u, v), radius, colour in zip(uv.tolist(), sizes.tolist(), colours.clip(0, 255).tolist(), strict=True):
            cv2.circle(image, (u, v), max(1, round(radius)), colour, -1)
            cv2.circle(self.occluders, (u, v), max(1, round(radius)), (distance,), -1)


def _mix(image: Image, other: Image, share: Field) -> None:
    """Replace the share (H, W) of an image by another, in place."""
    cv2.blendLinear(image, other, 1 - share, share, image)


def _scaled(image: Image, factor: Field) -> Image:
    return np.asarray(cv2.multiply(image, cv2.merge([factor] * 3), dtype=cv2.CV_8U), np.uint8)
