"""Everything that stands still, as one camera sees it: painted once, kept for every frame."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.synthetic.cameras import heads_in_view
from wibam_core.synthetic.layout import (
    PARKING_M,
    SIDEWALK_M,
    Building,
    Colour,
    Layout,
    Pole,
    SignalHead,
    Tree,
)
from wibam_core.synthetic.lighting import Lighting
from wibam_core.synthetic.raster import Image, View, fill, fill_any
from wibam_core.synthetic.shapes import bracket, housing, lift, markings, upright, windows

Array = NDArray[np.float64]
Distances = NDArray[np.float32]

WHITE: Colour = (225, 228, 228)
LAMP_COLOURS: dict[str, Colour] = {"red": (40, 40, 255), "amber": (20, 170, 255), "green": (130, 245, 60)}
_HOUSING: Colour = (28, 30, 28)
_LAMPS = ("red", "amber", "green")
_TILE_PX = 512
#: How far things reach from their foot, sideways.
_REACH_M = {Pole: 0.3, Tree: 3.5, SignalHead: 4.0}


@lru_cache(maxsize=4)
def _texture(number: int) -> NDArray[np.float32]:
    """(512, 512) seamless brightness around 1: coarse patches and fine grain."""
    rng = np.random.default_rng([number, 31])
    total = np.zeros((_TILE_PX, _TILE_PX), np.float32)
    for cells, strength in ((8, 0.05), (32, 0.04), (128, 0.035), (512, 0.03)):
        coarse = rng.standard_normal((cells, cells), dtype=np.float32)
        wrapped = np.pad(coarse, 2, mode="wrap")
        scale = _TILE_PX // cells
        big = cv2.resize(wrapped, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += strength * big[2 * scale : 2 * scale + _TILE_PX, 2 * scale : 2 * scale + _TILE_PX]
    return 1.0 + total


class Background:
    """The still part of a view.

    Attributes:
        occluders: (H, W) horizontal distance of whatever still thing stands upright at a pixel, m; infinite on
            ground and sky.
    """

    def __init__(self, layout: Layout, lighting: Lighting, view: View) -> None:
        self._layout, self._lighting, self._view = layout, lighting, view
        width, height = view.size
        self.occluders: Distances = np.full((height, width), np.inf, np.float32)
        image = np.zeros((height, width, 3), np.uint8)
        self._horizontal = np.hypot(view.rays[0], view.rays[1])
        self._paint_sky(image)
        self._paint_ground(image)
        image, dark = self._texture_ground(image)
        self._paint_upright(image, dark)
        self._image, self._dark = image, dark
        self._by_signals: dict[tuple[str, ...], tuple[Image, Image]] = {}

    def images(self, signals: Mapping[str, str]) -> tuple[Image, Image]:
        """The picture, and the same with all ground in shadow, for phase -> state ("red", "amber", "green", "off")."""
        phases = sorted({head.phase for head in self._layout.signals})
        key = tuple(signals.get(phase, "off") for phase in phases)
        if key not in self._by_signals:
            image, dark = self._image.copy(), self._dark.copy()
            for head in self._layout.signals:
                self._paint_lamps(image, head, signals.get(head.phase, "off"))
                self._paint_lamps(dark, head, signals.get(head.phase, "off"))
            self._by_signals[key] = (image, dark)
        return self._by_signals[key]

    def sees(self, head: SignalHead) -> bool:
        """Whether a head is turned to the camera, wholly in view, and its lamps hidden by nothing still."""
        if not heads_in_view(self._view.camera, [head])[0]:
            return False
        lamps = head.lamp_centres()
        distance = np.hypot(head.x_m - self._view.eye[0], head.y_m - self._view.eye[1])
        uv = self._view.pixels(self._view.to_camera(lamps))
        u, v = np.rint(uv).astype(int).T
        return bool((self.occluders[v, u] > distance - 0.5).all())

    # --- sky and ground ---------------------------------------------------------------------
    def _paint_sky(self, image: Image) -> None:
        """Fill everything with sky and bare terrain."""
        up = self._view.rays[2]
        elevation = up / np.maximum(self._horizontal, 1e-6)
        share = np.linspace(0, 1, 256)[:, None]
        lower, upper = np.array(self._lighting.sky_horizon), np.array(self._lighting.sky_top)
        table = (lower * (1 - share) + upper * share).astype(np.uint8)[:, None]
        cv2.applyColorMap(cv2.convertScaleAbs(elevation.clip(0), alpha=400), table, image)
        below = (elevation < -0.006).astype(np.uint8)  # the last stretch before the horizon is haze alone
        cv2.copyTo(np.full(image.shape, self._layout.terrain, np.uint8), below, image)

    def _paint_ground(self, image: Image) -> None:
        layout, view = self._layout, self._view
        for arm in layout.arms:
            extra = SIDEWALK_M + (PARKING_M if arm.parking else 0)
            walk = arm.strip(0.9 * arm.kerb_m, arm.length_m + 60, arm.out_edge_m - extra, arm.in_edge_m + extra)
            fill(image, view.polygon(lift(walk)), layout.sidewalk)
        fill_any(image, view.polygon(lift(layout.junction_sidewalk)), layout.sidewalk)
        lighter = (layout.asphalt[0] * 1.12, layout.asphalt[1] * 1.12, layout.asphalt[2] * 1.12)
        for arm in layout.arms:
            if arm.parking:
                bay = arm.strip(
                    arm.parking_start_m, arm.length_m + 60, arm.out_edge_m - PARKING_M, arm.in_edge_m + PARKING_M
                )
                fill(image, view.polygon(lift(bay)), lighter)
            road = arm.strip(0.8 * arm.kerb_m, arm.length_m + 60, arm.out_edge_m, arm.in_edge_m)
            fill(image, view.polygon(lift(road)), layout.asphalt)
        fill_any(image, view.polygon(lift(layout.junction)), layout.asphalt)
        painted = np.array([marking for arm in layout.arms for marking in markings(arm)])
        view.fill_quads(image, np.concatenate([painted, np.zeros((*painted.shape[:2], 1))], axis=2), WHITE)

    def _texture_ground(self, image: Image) -> tuple[Image, Image]:
        """Multiply in grain and haze, and lay shadows of still things; returns the lit and the shadowed picture."""
        view, lighting = self._view, self._lighting
        width, height = view.size
        # brightness and haze are smooth: half the resolution suffices
        rays = np.stack([cv2.resize(r, (width // 2, height // 2), interpolation=cv2.INTER_AREA) for r in view.rays])
        below = rays[2] < -1e-4
        scale = np.float32(-view.eye[2]) / np.minimum(rays[2], np.float32(-1e-4))
        texels = np.float32(_TILE_PX / 12.0)  # a tile is 12 m wide
        x = np.float32(view.eye[0] * texels) + scale * rays[0] * texels
        y = np.float32(view.eye[1] * texels) + scale * rays[1] * texels
        grain = cv2.remap(
            _texture(self._layout.seed % 4), x % _TILE_PX, y % _TILE_PX, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
        )
        distance = scale * np.hypot(rays[0], rays[1])
        fade = 0.25 + 0.75 * np.minimum(1.0, 18.0 / (distance + 1.0))
        clear = np.where(below, np.exp(-distance / np.float32(lighting.haze_m)), np.float32(1))
        light = np.where(below, 1 + (grain - 1) * fade, np.float32(1)) * clear

        def full(channels: list[NDArray]) -> Image:
            return cv2.resize(cv2.convertScaleAbs(cv2.merge(channels)), (width, height))

        haze = full([(1 - clear) * np.float32(c) for c in lighting.sky_horizon])
        lit = cv2.add(cv2.multiply(image, full([light * 160] * 3), scale=1 / 160), haze)
        tint = (lighting.shadow * 1.06, lighting.shadow, lighting.shadow * 0.95)
        dim = full([np.where(below, 1 - clear * np.float32(1 - t), np.float32(1)) * 250 for t in tint])
        dark = cv2.multiply(lit, dim, scale=1 / 250)
        shadows = np.zeros(image.shape[:2], np.uint8)
        for polygon in view.polygons([lift(p) for p in self._still_shadows()]):
            fill(shadows, polygon, (255,))
        return cv2.copyTo(dark, shadows, lit), dark

    def _still_shadows(self) -> list[Array]:
        sun = np.array(self._lighting.sun)
        reach = -sun[:2] / sun[2]
        if self._lighting.shadow > 0.9:
            return []
        shadows = []
        for building in self._layout.buildings:
            both = np.concatenate([building.footprint, building.footprint + reach * building.height_m])
            shadows.append(cv2.convexHull(both.astype(np.float32))[:, 0].astype(np.float64))
        side = np.array([-reach[1], reach[0]]) / (np.hypot(*reach) + 1e-9)
        for pole in self._layout.poles:
            foot = np.array([pole.x_m, pole.y_m])
            tip = foot + reach * pole.height_m
            w = pole.radius_m * side
            shadows.append(np.stack([foot - w, foot + w, tip + w, tip - w]))
        angle = np.linspace(0, 2 * np.pi, 10, endpoint=False)
        for tree in self._layout.trees:
            middle = np.array([tree.x_m, tree.y_m]) + reach * (tree.height_m - tree.crown_m)
            shadows.append(middle + tree.crown_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1) * 1.1)
        return shadows

    # --- upright things ---------------------------------------------------------------------
    def _paint_upright(self, image: Image, dark: Image) -> None:
        """Paint buildings, then poles, trees and signal heads from far to near, into both pictures."""
        view, layout = self._view, self._layout
        eye = view.eye[:2]
        before = image.copy()
        for building in sorted(layout.buildings, key=lambda b: -_distance_to_outline(b.footprint, eye)):
            outline = np.concatenate([lift(building.footprint), lift(building.footprint, building.height_m)])
            if view.may_see(outline, 0.0):
                self._paint_building(image, building)
        things: list[Pole | Tree | SignalHead] = [*layout.poles, *layout.trees, *layout.signals]
        places = np.array([[thing.x_m, thing.y_m] for thing in things])
        columns = np.concatenate([lift(places), lift(places, 10.0)], axis=1).reshape(-1, 2, 3)
        reach = np.array([_REACH_M[type(thing)] for thing in things])
        distances = np.hypot(*(places - eye).T)
        seen = np.flatnonzero(view.may_see(columns, reach) & (distances > 0.5))
        for i in seen[np.argsort(-distances[seen])].tolist():
            self._paint_behind_walls(image, things[i], float(distances[i]), columns[i], float(reach[i]))
        standing = np.isfinite(self.occluders).astype(np.uint8)
        cv2.copyTo(image, standing, dark)
        sky = (self._view.rays[2] >= -1e-4).astype(np.uint8) * (1 - standing)
        cv2.copyTo(before, sky, dark)

    def _paint_behind_walls(
        self, image: Image, thing: Pole | Tree | SignalHead, distance: float, column: Array, reach_m: float
    ) -> None:
        """Paint a thing, then take back what lies behind something nearer that was painted before."""
        part = self._patch(column, reach_m)
        hidden = (self.occluders[part] < distance).astype(np.uint8)
        covered = bool(hidden.any())
        if covered:
            image_before, occluders_before = image[part].copy(), self.occluders[part].copy()
        if isinstance(thing, Tree):
            self._paint_tree(image, thing, distance)
        elif isinstance(thing, Pole):
            self._paint_pole(image, thing, distance)
        else:
            self._paint_head(image, thing, distance)
        if covered:
            cv2.copyTo(image_before, hidden, image[part])
            cv2.copyTo(occluders_before, hidden, self.occluders[part])

    def _patch(self, column: Array, reach_m: float) -> tuple[slice, slice]:
        """The image patch around an upright segment (2, 3), grown by ``reach_m``."""
        width, height = self._view.size
        cam = self._view.to_camera(column)
        if (cam[:, 2] < reach_m + 0.5).any():
            return slice(0, height), slice(0, width)
        uv = self._view.pixels(cam)
        margin = 1.5 * reach_m * self._view.camera.K[0, 0] / (cam[:, 2].min() - reach_m) + 2
        low = np.clip(np.floor(uv.min(axis=0) - margin), 0, self._view.size).astype(int)
        high = np.clip(np.ceil(uv.max(axis=0) + margin), 0, self._view.size).astype(int)
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))

    def _shaded(self, colour: Colour, normal: Array) -> Colour:
        b, g, r = (np.array(colour) * self._lighting.shade(normal[None])[0]).clip(0, 255).tolist()
        return b, g, r

    def _paint_building(self, image: Image, building: Building) -> None:
        view = self._view
        for i in range(4):
            a, b = building.footprint[i], building.footprint[(i + 1) % 4]
            along = (b - a) / np.linalg.norm(b - a)
            normal = np.array([along[1], -along[0], 0.0])
            if normal[:2] @ (view.eye[:2] - a) <= 0:
                continue
            wall = view.polygon(upright(a, b, 0, building.height_m))
            if not len(wall):
                continue
            mask = np.zeros(image.shape[:2], np.uint8)
            fill_any(mask, wall, (1,))
            x, y, w, h = cv2.boundingRect(mask)
            if w == 0:
                continue
            fill_any(image, wall, self._shaded(building.colour, normal))
            part = np.s_[y : y + h, x : x + w]
            facing = np.float32(normal[0]) * view.rays[0][part] + np.float32(normal[1]) * view.rays[1][part]
            depth = np.float32(normal[:2] @ (a - view.eye[:2])) / np.minimum(facing, np.float32(-1e-6))
            np.copyto(self.occluders[part], depth * self._horizontal[part], where=mask[part] > 0)
            glass = self._shaded((95, 82, 70), normal)
            view.fill_quads(image, windows(a, b, building), glass)
        if view.eye[2] > building.height_m:
            roof = view.polygon(lift(building.footprint, building.height_m))
            if len(roof):
                fill_any(image, roof, self._shaded((130, 130, 135), np.array([0.0, 0, 1])))
                fill_any(self.occluders, roof, (_distance_to_outline(building.footprint, view.eye[:2]),))

    def _paint_pole(self, image: Image, pole: Pole, distance: float) -> None:
        side = self._sideways(pole.x_m, pole.y_m)
        foot = np.array([pole.x_m, pole.y_m])
        colour = self._shaded(pole.colour, np.array([-side[1], side[0], 0]))
        bright = self._shaded(pole.colour, np.array([0.0, 0, 1]))
        r = pole.radius_m
        halves = [
            upright(foot - r * side, foot, 0, pole.height_m),
            upright(foot, foot + r * side, 0, pole.height_m),
        ]
        for polygon, shade in zip(self._view.polygons(halves), (colour, bright), strict=True):
            fill(image, polygon, shade)
            fill(self.occluders, polygon, (distance,))

    def _paint_tree(self, image: Image, tree: Tree, distance: float) -> None:
        side = self._sideways(tree.x_m, tree.y_m)
        foot = np.array([tree.x_m, tree.y_m])
        trunk = self._view.polygon(upright(foot - 0.14 * side, foot + 0.14 * side, 0, tree.height_m - tree.crown_m))
        fill(image, trunk, self._shaded((45, 60, 75), np.array([0.0, 0, 1])))
        fill(self.occluders, trunk, (distance,))
        rng = np.random.default_rng(abs(int(tree.x_m * 1000)))
        offsets = rng.normal(0, 0.42, (12, 3)) * tree.crown_m
        offsets = offsets[np.argsort(offsets[:, 2])]
        centre = np.array([tree.x_m, tree.y_m, tree.height_m - tree.crown_m])
        cam = self._view.to_camera(centre + offsets)
        if cam[:, 2].min() < 1.0:
            return
        uv = np.rint(self._view.pixels(cam)).astype(int)
        radius = np.maximum(1, np.rint(0.62 * tree.crown_m * self._view.camera.K[0, 0] / cam[:, 2])).astype(int)
        for (u, v), r, z in zip(uv.tolist(), radius.tolist(), offsets[:, 2], strict=True):
            brightness = 0.75 + 0.35 * float(np.clip(z / tree.crown_m, -1, 1))
            b, g, red = (np.array(tree.colour) * brightness).clip(0, 255).tolist()
            cv2.circle(image, (u, v), r, (b, g, red), -1)
            cv2.circle(self.occluders, (u, v), r, (distance,), -1)

    def _paint_head(self, image: Image, head: SignalHead, distance: float) -> None:
        arm = bracket(head)
        if arm is not None:
            uv = self._view.polygon(arm)
            fill(image, uv, (90, 90, 90))
            fill(self.occluders, uv, (distance,))
        for outline in housing(head):
            uv = self._view.polygon(outline)
            fill(image, uv, _HOUSING)
            fill(self.occluders, uv, (distance,))
        if self._faces(head):
            for lamp in self._lamp_outlines(head):
                fill(image, lamp, (48, 48, 48))

    def _paint_lamps(self, image: Image, head: SignalHead, state: str) -> None:
        if state == "off" or not self._faces(head):
            return
        number = _LAMPS.index(state)
        lamp = self._lamp_outlines(head)[number]
        if not len(lamp):
            return
        u, v = np.rint(lamp.mean(axis=0)).astype(int)
        if not (0 <= u < self._view.size[0] and 0 <= v < self._view.size[1]):
            return
        distance = float(np.hypot(head.x_m - self._view.eye[0], head.y_m - self._view.eye[1]))
        if self.occluders[v, u] < distance - 0.5:
            return
        fill(image, lamp, LAMP_COLOURS[state])
        middle = lamp.mean(axis=0)
        b, g, r = LAMP_COLOURS[state]
        fill(image, middle + (lamp - middle) * 0.5, (b * 0.6 + 100, g * 0.6 + 100, r * 0.6 + 100))

    def _faces(self, head: SignalHead) -> bool:
        towards = self._view.eye[:2] - np.array([head.x_m, head.y_m])
        return bool(towards @ np.array([np.cos(head.facing_rad), np.sin(head.facing_rad)]) > 0)

    def _lamp_outlines(self, head: SignalHead) -> list[Array]:
        c, s = np.cos(head.facing_rad), np.sin(head.facing_rad)
        angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        circle = head.lamp_radius_m * (
            np.cos(angle)[:, None] * np.array([-s, c, 0]) + np.sin(angle)[:, None] * np.array([0, 0, 1])
        )
        return self._view.polygons([centre + circle for centre in head.lamp_centres()])

    def _sideways(self, x_m: float, y_m: float) -> Array:
        """Unit ground direction to the right as seen from the camera."""
        towards = np.array([x_m, y_m]) - self._view.eye[:2]
        return np.asarray(np.array([towards[1], -towards[0]]) / (np.linalg.norm(towards) + 1e-9))


def _distance_to_outline(footprint: Array, eye: Array) -> float:
    inside = cv2.pointPolygonTest(footprint.astype(np.float32), (float(eye[0]), float(eye[1])), True)
    return max(0.0, -float(inside))
