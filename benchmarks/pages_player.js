// Draws instants of 60 vehicles from above and in four views, as the player does, and says what the script took for each.
async (instants) => {
  const { drawFrame, drawRoad } = await import("/static/js/playerdraw.js");
  const { Camera } = await import("/static/js/projection.js");
  const { Plan } = await import("/static/js/plan.js");
  const { Tracks } = await import("/static/js/trackdata.js");
  const states = [];
  for (let t = 0; t < instants; t += 1) {
    for (let id = 0; id < 60; id += 1) {
      const place = { x_m: (id % 8) * 6 - 24 + t * 0.3, y_m: Math.floor(id / 8) * 5 - 18, z_m: 0.75, yaw_rad: 0 };
      const size = { length_m: 4.4, width_m: 1.8, height_m: 1.5 };
      states.push({ time_ns: t * 1e8, track_id: id, class: "car", speed_mps: 3, ...place, ...size });
    }
  }
  const tracks = new Tracks(states);
  const camera = (id, x, y) => {
    const n = Math.hypot(x, y), c = -x / n, s = -y / n;
    return new Camera({
      id, width_px: 640, height_px: 360, K: [[380, 0, 320], [0, 380, 180], [0, 0, 1]], dist: [-0.28, 0.09, 0.001, -0.0005, -0.01], distortion_limit: null,
      T_world_cam: [[s, -0.35 * c, 0.94 * c, x], [-c, -0.35 * s, 0.94 * s, y], [0, -0.94, -0.35, 8]],
    });
  };
  const cameras = [camera("a", 30, 2), camera("b", -30, 3), camera("c", 2, 30), camera("d", 1, -30)];
  const canvas = () => Object.assign(document.createElement("canvas"), { width: 480, height: 270 });
  const canvases = cameras.map(canvas), image = await createImageBitmap(canvas());
  const shown = {
    states: [], tracks, timeNs: 0, trailNs: 3e9, chosen: new Set([3]), polygon: [], conflict: null, cameras,
    colour: () => "#0072b2",
  };
  const plan = new Plan(canvas(), (view, context) => drawRoad(view, context, shown));
  const costs = [];
  for (let t = 0; t < instants; t += 1) {
    const start = performance.now();
    shown.states = tracks.at[t];
    shown.timeNs = tracks.times[t];
    plan.drawNow();
    cameras.forEach((one, index) => {
      const exposed = shown.states.map((state) => tracks.moved(state, shown.timeNs + 2e7)); // each camera a little later
      drawFrame(canvases[index], one, image, { ...shown, states: exposed }, true);
    });
    costs.push(performance.now() - start);
  }
  const seen = shown.states.reduce((sum, state) => sum + cameras.filter((one) => one.boxAround(
    [state.x_m, state.y_m, state.z_m, state.length_m, state.width_m, state.height_m, state.yaw_rad])).length, 0);
  const blue = ([red, green, value]) => value > 160 && value > green + 30 && green > red + 40;
  const pixels = plan.canvas.getContext("2d").getImageData(0, 0, 480, 270).data;
  let coloured = 0;
  for (let at = 0; at < pixels.length; at += 4) coloured += blue([pixels[at], pixels[at + 1], pixels[at + 2]]) ? 1 : 0;
  return { costs, seen, coloured };
}
