// A heat map of places on the ground.
import { token } from "./plan.js";

const SPREAD_M = 2.5, CELL_PX = 6;

/** Sum of Gaussian hills at places, drawn beneath their marks. @param {import("./plan.js").Plan} plan @param {CanvasRenderingContext2D} context @param {any[]} conflicts */
export function drawHeat(plan, context, conflicts) {
  const columns = Math.ceil(plan.canvas.width / CELL_PX), rows = Math.ceil(plan.canvas.height / CELL_PX), sums = new Float32Array(columns * rows);
  const spread = (SPREAD_M * plan.pxPerM) / CELL_PX, reach = Math.ceil(3 * spread);
  for (const one of conflicts) {
    const [x, y] = plan.toCanvas([one.x_m, one.y_m]).map((value) => value / CELL_PX);
    for (let i = Math.max(0, Math.floor(x) - reach); i < Math.min(columns, x + reach); i += 1) {
      for (let j = Math.max(0, Math.floor(y) - reach); j < Math.min(rows, y + reach); j += 1) {
        sums[j * columns + i] += Math.exp(-((i + 0.5 - x) ** 2 + (j + 0.5 - y) ** 2) / (2 * spread * spread));
      }
    }
  }
  const most = sums.reduce((a, b) => Math.max(a, b), 0);
  for (let j = 0; j < rows; j += 1) {
    for (let i = 0; i < columns; i += 1) {
      const share = most ? sums[j * columns + i] / most : 0;
      if (share < 0.03) continue;
      context.fillStyle = `hsl(${50 - 50 * share} 95% 50% / ${0.15 + 0.6 * share})`;
      context.fillRect(i * CELL_PX, j * CELL_PX, CELL_PX, CELL_PX);
    }
  }
  context.font = "600 13px system-ui, sans-serif";
  context.textAlign = "center";
  for (const one of conflicts) {
    const [x, y] = plan.toCanvas([one.x_m, one.y_m]);
    context.strokeStyle = context.fillStyle = token("--ink");
    context.lineWidth = 1.6;
    context.beginPath(); context.arc(x, y, 4, 0, 2 * Math.PI); context.stroke();
    plan.write(context, String(one.conflict_id), [x, y - 8]);
  }
}
