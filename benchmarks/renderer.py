"""Images per second and core of the renderer: recordings (one camera, many frames) and training views.

Run: python benchmarks/renderer.py [frames]
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np

from wibam_core.synthetic.cameras import site_cameras
from wibam_core.synthetic.layout import make_layout
from wibam_core.synthetic.lighting import develop, sample_lighting, sample_photometry
from wibam_core.synthetic.render import Renderer
from wibam_core.synthetic.routes import make_routes
from wibam_core.synthetic.sampling import Regime, sample_moment, sample_views


def frames_per_second(frames: int, size_px: tuple[int, int]) -> tuple[float, float]:
    """Images per CPU second of one site camera after its background is cached, and vehicles per image."""
    rng = np.random.default_rng(5)
    layout = make_layout(5)
    routes = make_routes(layout)
    camera = site_cameras(layout, rng, 4, size_px)[0]
    renderer = Renderer(layout, sample_lighting(rng), camera)
    moments = [sample_moment(layout, routes, rng) for _ in range(10)]
    photometry = sample_photometry(rng)
    signals = {"a": "green", "b": "red"}
    for models, boxes in moments:
        renderer.draw(models, boxes, signals)
    seen = 0
    start = time.process_time()
    for i in range(frames):
        models, boxes = moments[i % len(moments)]
        drawing = renderer.draw(models, boxes, signals)
        develop(drawing.image, photometry, rng)
        seen += int(drawing.in_view.sum())
    return frames / (time.process_time() - start), seen / frames


def views_per_second(regime: Regime, count: int) -> float:
    """Training views per CPU second at 512x288, set-up of scenes included."""
    next(sample_views(999, regime, 1))
    start = time.process_time()
    for seed in range(count // 20):
        for _ in sample_views(seed, regime, 20):
            pass
    return count / (time.process_time() - start)


def main() -> None:
    cv2.setNumThreads(1)
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 300
    rate, vehicles = frames_per_second(frames, (640, 360))
    print(f"site recording 640x360: {rate:.0f} images/s per core ({vehicles:.1f} vehicles in view)")
    regimes: tuple[Regime, ...] = ("ego", "site", "elevated")
    for regime in regimes:
        print(f"{regime} training views 512x288: {views_per_second(regime, 60):.0f} views/s per core")


if __name__ == "__main__":
    main()
