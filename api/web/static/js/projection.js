// Projection between the world and pixels, equal to `wibam_core.geometry` in its conventions:
// world in m, Z up; camera x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.
// Boxes are arrays [x, y, z, length, width, height, yaw] (m, rad).

/**
 * @typedef {Object} SceneCamera as `GET /v1/jobs/{id}/scene` says it
 * @property {string} id
 * @property {number} width_px
 * @property {number} height_px
 * @property {number[][]} K
 * @property {number[]} dist
 * @property {number|null} distortion_limit
 * @property {number[][]} T_world_cam
 */

/** Parts of a box nearer than this along the optical axis are cut off before projection (m). */
export const NEAR_M = 0.1;
/** Corner numbers of a box's edges: 0 to 3 are the bottom from the front left counter-clockwise, 4 to 7 the top. */
export const EDGES = [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
const SIGNS = [[1, 1, -1], [-1, 1, -1], [-1, -1, -1], [1, -1, -1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]];
const PIECES = 8;

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
    this.hasDistortion = scene.dist.some((value) => value !== 0);
    this.dist = [...scene.dist, ...new Array(12).fill(0)].slice(0, 12);
    this.limit = scene.distortion_limit ?? Infinity;
    this.rotation = scene.T_world_cam.map((row) => row.slice(0, 3));
    this.centre = scene.T_world_cam.map((row) => row[3]);
  }

  /** World point to the camera frame. @param {number[]} point @returns {number[]} */
  toCamera(point) {
    const R = this.rotation, d = [point[0] - this.centre[0], point[1] - this.centre[1], point[2] - this.centre[2]];
    return [0, 1, 2].map((k) => R[0][k] * d[0] + R[1][k] * d[1] + R[2][k] * d[2]);
  }

  /** Camera-frame point with positive z to its pixel. @param {number[]} point @returns {number[]} */
  pixelOf(point) {
    let x = point[0] / point[2], y = point[1] / point[2];
    if (this.hasDistortion) [x, y] = distort(this.dist, x, y, this.limit);
    return [this.K[0][0] * x + this.K[0][1] * y + this.K[0][2], this.K[1][1] * y + this.K[1][2]];
  }

  /** World point to its pixel; null where it is not in front of the camera. @param {number[]} point */
  project(point) {
    const seen = this.toCamera(point);
    return seen[2] > 0 ? this.pixelOf(seen) : null;
  }

  /** The ray through a pixel: a direction in the world, from `centre`. @param {number[]} pixel @returns {number[]} */
  ray(pixel) {
    let y = (pixel[1] - this.K[1][2]) / this.K[1][1];
    let x = (pixel[0] - this.K[0][2] - this.K[0][1] * y) / this.K[0][0];
    if (this.hasDistortion) [x, y] = undistort(this.dist, x, y, this.limit);
    const d = [x, y, 1], R = this.rotation;
    const world = [0, 1, 2].map((i) => R[i][0] * d[0] + R[i][1] * d[1] + R[i][2] * d[2]);
    const norm = Math.hypot(...world);
    return world.map((value) => value / norm);
  }

  /** Where the ray through a pixel meets the plane z = height; null above the horizon. @param {number[]} pixel @param {number} [z] */
  ground(pixel, z = 0) {
    const d = this.ray(pixel), t = (z - this.centre[2]) / d[2];
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
  line(from, to, pieces = PIECES) {
    let a = this.toCamera(from), b = this.toCamera(to);
    if (a[2] < NEAR_M && b[2] < NEAR_M) return [];
    const cut = (/** @type {number[]} */ p, /** @type {number[]} */ q) => {
      const t = (NEAR_M - p[2]) / (q[2] - p[2]);
      return p.map((value, k) => value + t * (q[k] - value));
    };
    if (a[2] < NEAR_M) a = cut(a, b);
    else if (b[2] < NEAR_M) b = cut(b, a);
    const count = this.hasDistortion ? pieces : 1, found = [];
    for (let i = 0; i <= count; i += 1) {
      const t = i / count;
      found.push(this.pixelOf([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), a[2] + t * (b[2] - a[2])]));
    }
    return found;
  }

  /** The edges of a box in the image, in the order of `EDGES`. @param {number[]} box @returns {number[][][]} */
  boxEdges(box) {
    const points = corners(box);
    return EDGES.map(([i, j]) => this.line(points[i], points[j]));
  }

  /** The tight 2D box x0, y0, x1, y1 around a 3D box, cut to the image; null where the camera does not see it. @param {number[]} box */
  boxAround(box) {
    const pixels = this.boxEdges(box).flat();
    if (!pixels.length) return null;
    const u = pixels.map((p) => p[0]), v = pixels.map((p) => p[1]);
    const x0 = Math.min(...u), y0 = Math.min(...v), x1 = Math.max(...u), y1 = Math.max(...v);
    const right = this.width - 0.5, bottom = this.height - 0.5;
    if (x0 >= right || y0 >= bottom || x1 <= -0.5 || y1 <= -0.5) return null;
    return [Math.max(x0, -0.5), Math.max(y0, -0.5), Math.min(x1, right), Math.min(y1, bottom)];
  }
}

/** OpenCV's distortion, continued in straight lines beyond `limit`. @param {number[]} k @param {number} x @param {number} y @param {number} limit */
function distort(k, x, y, limit) {
  const inside = limit / Math.max(Math.hypot(x, y), limit);
  const scale = Number.isFinite(inside) ? inside : 1;
  const [dx, dy] = polynomial(k, x * scale, y * scale);
  return [dx / scale, dy / scale];
}

/** @param {number[]} k @param {number} x @param {number} y */
function polynomial(k, x, y) {
  const [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = k;
  const r2 = x * x + y * y;
  const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)));
  return [
    x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + r2 * (s1 + r2 * s2),
    y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + r2 * (s3 + r2 * s4),
  ];
}

/** The inverse of `distort`, by Newton's method with halved steps. @param {number[]} k @param {number} u @param {number} v @param {number} limit */
function undistort(k, u, v, limit) {
  let x = u, y = v;
  const missing = (/** @type {number} */ a, /** @type {number} */ b) => {
    const [p, q] = distort(k, a, b, limit);
    return [u - p, v - q];
  };
  let [ex, ey] = missing(x, y), error = Math.hypot(ex, ey);
  for (let step = 0; step < 60 && error > 1e-13; step += 1) {
    const h = 1e-6 * Math.max(1, Math.hypot(x, y));
    const [ax, ay] = missing(x + h, y), [bx, by] = missing(x, y + h);
    const a = (ex - ax) / h, c = (ey - ay) / h, b = (ex - bx) / h, d = (ey - by) / h, det = a * d - b * c;
    if (!det) break;
    let sx = (d * ex - b * ey) / det, sy = (a * ey - c * ex) / det, better = false;
    for (let half = 0; half < 30 && !better; half += 1) {
      const [nx, ny] = missing(x + sx, y + sy), trial = Math.hypot(nx, ny);
      better = trial < error;
      if (better) { x += sx; y += sy; ex = nx; ey = ny; error = trial; } else { sx /= 2; sy /= 2; }
    }
    if (!better) break;
  }
  return [x, y];
}
