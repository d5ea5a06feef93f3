// Projection between the world and pixels, equal to `wibam_core.geometry` in its conventions:
// world in m, Z up; camera x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.
// Boxes are arrays [x, y, z, length, width, height, yaw] (m, rad).

import { lensOf } from "./lenses.js";

/**
 * @typedef {Object} SceneCamera as `GET /v1/jobs/{id}/scene` says it
 * @property {string} id
 * @property {number} width_px
 * @property {number} height_px
 * @property {number[][]} K
 * @property {number[]} dist
 * @property {number|null} distortion_limit
 * @property {number[][]} T_world_cam
 * @property {"pinhole"|"fisheye"|"omnidirectional"} [lens]
 * @property {number} [xi]
 * @property {number|null} [limit_rad]
 */

/** Parts of a box nearer than this along the optical axis are cut off before projection (m). */
export const NEAR_M = 0.1;
/** Corner numbers of a box's edges: 0 to 3 are the bottom from the front left counter-clockwise, 4 to 7 the top. */
export const EDGES = [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
const SIGNS = [[1, 1, -1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]];
const PIECES = 8, WIDE_PIECES = 32;

/** The eight corners of a box in the world. @param {number[]} box @returns {number[][]} */
export function corners(box) {
  const [x, y, z, length, width, height, yaw] = box;
  const c = Math.cos(yaw), s = Math.sin(yaw);
  return SIGNS.map(([a, b, d]) => {
    const forward = (a * length) / 2, left = (b * width) / 2;
    return [x + c * forward - s * left, y + s * forward + c * left, z + (d * height) / 2];
  });
}

/** Footprint of a box on the ground. @param {number[]} box @returns {number[][]} four corners x, y */
export function footprint(box) {
  return corners(box).slice(0, 4).map(([x, y]) => [x, y]);
}

/** A calibrated camera. */
export class Camera {
  /** @param {SceneCamera} scene */
  constructor(scene) {
    this.id = scene.id;
    this.width = scene.width_px;
    this.height = scene.height_px;
    this.K = scene.K;
    this.lens = lensOf(scene);
    this.isWide = scene.lens === "fisheye" || scene.lens === "omnidirectional";
    this.rotation = scene.T_world_cam.map((row) => row.slice(0, 3));
    this.centre = scene.T_world_cam.map((row) => row[3]);
  }

  /** World point to the camera frame. @param {number[]} point @returns {number[]} */
  toCamera(point) {
    const R = this.rotation, d = [point[0] - this.centre[0], point[1] - this.centre[1], point[2] - this.centre[2]];
    return [R[0][0] * d[0] + R[1][0] * d[1] + R[2][0] * d[2], R[0][1] * d[0] + R[1][1] * d[1] + R[2][1] * d[2], R[0][2] * d[0] + R[1][2] * d[1] + R[2][2] * d[2]];
  }

  /** Camera-frame point that the lens sees to its pixel. @param {number[]} point @returns {number[]} */
  pixelOf(point) {
    const [x, y] = this.lens.toPlane(point);
    return [this.K[0][0] * x + this.K[0][1] * y + this.K[0][2], this.K[1][1] * y + this.K[1][2]];
  }

  /** World point to its pixel; null where it is not in front of the camera. @param {number[]} point */
  project(point) {
    const seen = this.toCamera(point);
    return this.lens.sees(seen) ? this.pixelOf(seen) : null;
  }

  /** The ray through a pixel: a direction in the world, from `centre`; null where the lens has none. @param {number[]} pixel @returns {number[]|null} */
  ray(pixel) {
    const y = (pixel[1] - this.K[1][2]) / this.K[1][1], x = (pixel[0] - this.K[0][2] - this.K[0][1] * y) / this.K[0][0];
    const d = this.lens.toDirection([x, y]), R = this.rotation;
    if (!d) return null;
    const world = [0, 1, 2].map((i) => R[i][0] * d[0] + R[i][1] * d[1] + R[i][2] * d[2]);
    const norm = Math.hypot(...world);
    return world.map((value) => value / norm);
  }

  /** Where the ray through a pixel meets the plane z = height; null above the horizon. @param {number[]} pixel @param {number} [z] */
  ground(pixel, z = 0) {
    const d = this.ray(pixel);
    if (!d) return null;
    const t = (z - this.centre[2]) / d[2];
    return t > 0 && Number.isFinite(t) ? [this.centre[0] + t * d[0], this.centre[1] + t * d[1], z] : null;
  }

  /** Whether a pixel lies in the image. @param {number[]|null} pixel */
  contains(pixel) {
    return pixel !== null && pixel[0] >= -0.5 && pixel[1] >= -0.5 && pixel[0] < this.width - 0.5 && pixel[1] < this.height - 0.5;
  }

  /**
   * A line of the world in the image: cut off close to the camera, bent where the lens bends it.
   * @param {number[]} from @param {number[]} to @param {number} [pieces]
   * @returns {number[][]} pixels; none where nothing of it is in front of the camera
   */
  line(from, to, pieces = this.isWide ? WIDE_PIECES : PIECES) {
    let a = this.toCamera(from), b = this.toCamera(to);
    const at = (/** @type {number} */ t) => [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])];
    if (this.isWide) { // it may see beside and behind itself: the points that it sees count, and there is no near plane
      return Array.from({ length: pieces + 1 }, (_, i) => at(i / pieces)).filter(this.lens.sees).map((point) => this.pixelOf(point));
    }
    if (a[2] < NEAR_M && b[2] < NEAR_M) return [];
    const cut = (/** @type {number[]} */ p, /** @type {number[]} */ q) => {
      const t = (NEAR_M - p[2]) / (q[2] - p[2]);
      return p.map((value, k) => value + t * (q[k] - value));
    };
    if (a[2] < NEAR_M) a = cut(a, b);
    else if (b[2] < NEAR_M) b = cut(b, a);
    const count = this.lens.bends ? pieces : 1;
    const pixels = [];
    for (let i = 0; i <= count; i += 1) pixels.push(this.pixelOf(at(i / count)));
    return pixels;
  }

  /** The edges of a box in the image, in the order of `EDGES`. @param {number[]} box @returns {number[][][]} */
  boxEdges(box) {
    const points = corners(box);
    return EDGES.map(([i, j]) => this.line(points[i], points[j]));
  }

  /** The tight 2D box x0, y0, x1, y1 around a 3D box, cut to the image; null where the camera does not see it. @param {number[]} box */
  boxAround(box) {
    return this.around(this.boxEdges(box));
  }

  /** The same of edges that are known. @param {number[][][]} edges as `boxEdges` has them */
  around(edges) {
    let x0 = Infinity, y0 = Infinity, x1 = -Infinity, y1 = -Infinity;
    for (const edge of edges) {
      for (const [u, v] of edge) { x0 = Math.min(x0, u); y0 = Math.min(y0, v); x1 = Math.max(x1, u); y1 = Math.max(y1, v); }
    }
    if (x0 > x1) return null;
    const right = this.width - 0.5, bottom = this.height - 0.5;
    if (x0 >= right || y0 >= bottom || x1 <= -0.5 || y1 <= -0.5) return null;
    return [Math.max(x0, -0.5), Math.max(y0, -0.5), Math.min(x1, right), Math.min(y1, bottom)];
  }
}
