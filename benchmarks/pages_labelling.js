// Drags one of 30 labelled vehicles, seen from above and in four views, as the page of labels does, and says what the script
// took for each step.
async (steps) => {
  const { Camera } = await import("/static/js/projection.js");
  const { FrameView } = await import("/static/js/frameview.js");
  const { Plan } = await import("/static/js/plan.js");
  const { Model } = await import("/static/js/labelmodel.js");
  const { draggedInPlan } = await import("/static/js/labelpointer.js");
  const { drawCuboids, drawVehicles } = await import("/static/js/labeldraw.js");
  const canvas = (width, height) => document.body.appendChild(Object.assign(document.createElement("canvas"), { width, height }));
  const camera = (id, x, y) => {
    const n = Math.hypot(x, y), c = -x / n, s = -y / n;
    return new Camera({
      id, width_px: 1920, height_px: 1080, K: [[1140, 0, 960], [0, 1140, 540], [0, 0, 1]], dist: [-0.28, 0.09, 0.001, -0.0005, -0.01], distortion_limit: null,
      T_world_cam: [[s, -0.35 * c, 0.94 * c, x], [-c, -0.35 * s, 0.94 * s, y], [0, -0.94, -0.35, 8]],
    });
  };
  const cameras = [camera("a", 30, 2), camera("b", -30, 3), camera("c", 2, 30), camera("d", 1, -30)];
  const vehicles = [...Array(30).keys()].map((id) => ({
    id, class: "car", box: [(id % 6) * 8 - 20, Math.floor(id / 6) * 7 - 14, 0.75, 4.4, 1.8, 1.5, 0.3 * id], velocity_mps: [3, 0], visibility: {}, ignored: false, seconds: 0,
  }));
  const colours = new Map([["car", "#0072b2"]]), model = new Model(() => {}), frame = await createImageBitmap(canvas(1280, 720));
  model.load(vehicles, false, []);
  const plan = new Plan(canvas(1000, 760), (view, context) => drawVehicles(view, context, model.vehicles, model.chosen, colours));
  const views = cameras.map((one) => {
    const view = new FrameView(canvas(1280, 720), 1920, 1080, (shown, context) => drawCuboids(shown, context, one, model.vehicles, model.chosen, colours, 0.02));
    view.show(frame);
    return view;
  });
  const from = model.current, grip = { kind: "body", id: from.id }, costs = [];
  for (let step = 0; step < steps; step += 1) {
    const start = performance.now();
    model.update({ box: draggedInPlan(from.box, grip, [0, 0], [0.05 * step, 0.02 * step]) }, "drag");
    plan.drawNow();
    for (const view of views) view.drawNow();
    costs.push(performance.now() - start);
    if (step % 10 === 9) await new Promise((resolve) => requestAnimationFrame(resolve));
  }
  return { costs, moved: model.current.box[0] - from.box[0] };
}
