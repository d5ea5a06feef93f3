// Lenses: directions to points of the lens plane and back, as `wibam_core.geometry` maps them. The intrinsic matrix turns
// points of the lens plane into pixels.

/**
 * @typedef {Object} Lens
 * @property {boolean} bends whether straight lines become curves
 * @property {(point: number[]) => boolean} sees which camera-frame points are in front of it
 * @property {(point: number[]) => number[]} toPlane of a point that it sees
 * @property {(plane: number[]) => number[]|null} toDirection in the camera's frame, of any length; null where there is none
 */

/**
 * The lens of a camera.
 * @param {import("./projection.js").SceneCamera} scene
 * @returns {Lens}
 */
export function lensOf(scene) {
  if (scene.lens === "fisheye") return fisheye(scene.dist, scene.limit_rad ?? Math.PI / 2);
  const k = [...scene.dist, ...new Array(12).fill(0)].slice(0, 12), limit = scene.distortion_limit ?? Infinity;
  if (scene.lens === "omnidirectional") return omnidirectional(k, limit, scene.xi ?? 0, scene.limit_rad ?? Math.PI / 2);
  const bends = k.some((value) => value !== 0);
  return {
    bends,
    sees: (point) => point[2] > 0,
    toPlane: ([x, y, z]) => (bends ? distort(k, x / z, y / z, limit) : [x / z, y / z]),
    toDirection: ([x, y]) => [...(bends ? undistort(k, x, y, limit) : [x, y]), 1],
  };
}

/** Angle between the optical axis and a camera-frame point. @param {number[]} point */
const angleOf = ([x, y, z]) => Math.atan2(Math.hypot(x, y), z);

/** OpenCV's fisheye. @param {number[]} dist @param {number} limit rad @returns {Lens} */
function fisheye(dist, limit) {
  const [k1, k2, k3, k4] = [...dist, 0, 0, 0, 0];
  const radius = (/** @type {number} */ a) => { const q = a * a; return a * (1 + q * (k1 + q * (k2 + q * (k3 + q * k4)))); };
  const slope = (/** @type {number} */ a) => { const q = a * a; return 1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4))); };
  const widest = radius(limit);
  return {
    bends: true,
    sees: (point) => angleOf(point) <= limit,
    toPlane: ([x, y, z]) => {
      const across = Math.hypot(x, y), scale = across > 0 ? radius(Math.atan2(across, z)) / across : 1;
      return [x * scale, y * scale];
    },
    toDirection: ([x, y]) => {
      const wanted = Math.hypot(x, y);
      if (wanted > widest * (1 + 1e-12)) return null;
      let low = 0, high = limit; // the formula rises up to the limit: halve first, then Newton's steps
      for (let step = 0; step < 12; step += 1) { const middle = (low + high) / 2; if (radius(middle) < wanted) low = middle; else high = middle; }
      let angle = (low + high) / 2;
      for (let step = 0; step < 6; step += 1) angle = Math.min(Math.max(angle - (radius(angle) - wanted) / slope(angle), 0), limit);
      const sine = Math.sin(angle);
      return wanted > 0 ? [(x / wanted) * sine, (y / wanted) * sine, Math.cos(angle)] : [0, 0, 1];
    },
  };
}

/** OpenCV's omnidirectional lens (Mei and Rives). @param {number[]} k @param {number} limit of the distortion @param {number} xi @param {number} widest rad @returns {Lens} */
function omnidirectional(k, limit, xi, widest) {
  return {
    bends: true,
    sees: (point) => angleOf(point) <= widest,
    toPlane: (point) => {
      const along = point[2] + xi * Math.hypot(...point);
      return distort(k, point[0] / along, point[1] / along, limit);
    },
    toDirection: ([u, v]) => {
      const [x, y] = undistort(k, u, v, limit), r2 = x * x + y * y, root = 1 + (1 - xi * xi) * r2;
      if (root < 0) return null;
      const lift = (xi + Math.sqrt(root)) / (1 + r2), direction = [x * lift, y * lift, lift - xi];
      return angleOf(direction) <= widest ? direction : null;
    },
  };
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
