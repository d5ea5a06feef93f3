"""Painted signal heads for tests: what a camera would see of a traffic light, frame by frame."""

from itertools import pairwise

import cv2
import numpy as np

LIT = {"red": (40, 30, 240), "amber": (30, 150, 250), "green": (150, 220, 60)}
CYCLE = (("green", 9.0), ("amber", 3.0), ("red", 10.0))
GERMAN_CYCLE = (("green", 9.0), ("amber", 3.0), ("red", 8.0), ("red_amber", 1.4))


def sequence(cycle, duration_s, phase_s=0.0):
    """[(start_s, state)] and a function from time to state."""
    starts, t = [], -phase_s
    while t < duration_s:
        for state, length in cycle:
            starts.append((t, state))
            t += length
    return starts


def state_at(starts, t):
    return [state for start, state in starts if start <= t][-1]


def truth(starts, duration_s, margin_s=0.6):
    return [(t, before, after) for (_, before), (t, after) in pairwise(starts) if margin_s < t < duration_s - margin_s]


def paint(state, size, *, horizontal=False, gain=1.0, scene=(90, 100, 95), lamp_gain=1.0, colours=LIT):
    """A signal head filling ``size`` (w, h), drawn large and shrunk as a camera would."""
    w, h = size
    scale = 8
    image = np.full((h * scale, w * scale, 3), scene, np.uint8)
    long, short = (w, h) if horizontal else (h, w)
    cv2.rectangle(image, (scale // 2, scale // 2), (w * scale - scale // 2, h * scale - scale // 2), (25, 25, 22), -1)
    for i, name in enumerate(("red", "amber", "green")):
        along = (i + 0.5) * long * scale / 3
        centre = (along, short * scale / 2) if horizontal else (short * scale / 2, along)
        on = name in state.split("_")
        colour = np.array(colours[name]) * lamp_gain if on else np.array([20, 22, 24])
        radius = 0.38 * min(short, long / 3) * scale
        cv2.circle(image, (round(centre[0]), round(centre[1])), round(radius), colour.tolist(), -1, cv2.LINE_AA)
    image = cv2.resize(image, (w, h), interpolation=cv2.INTER_AREA)
    return np.clip(image * gain, 0, 255).astype(np.uint8)


def record(
    starts,
    duration_s=45.0,
    fps=12.5,
    size=(10, 26),
    noise=6.0,
    seed=0,
    jpeg=None,
    gain=lambda t: 1.0,
    lamp_gain=lambda t: 1.0,
    over=None,
    dropped=0.0,
    **kwargs,
):
    """Frames (time_ns, image) of a head at x 20, y 16, as a stream."""
    rng = np.random.default_rng(seed)
    w, h = size
    for i in range(int(duration_s * fps)):
        t = (i + 0.37) / fps
        image = np.full((h + 32, w + 40, 3), (95, 105, 100), np.uint8)
        image[16 : 16 + h, 20 : 20 + w] = paint(
            state_at(starts, t), size, gain=gain(t), lamp_gain=lamp_gain(t), **kwargs
        )
        if over is not None:
            over(t, image)
        image = np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)
        if jpeg is not None:
            image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, jpeg])[1], cv2.IMREAD_COLOR)
        if rng.random() >= dropped:
            yield round(t * 1e9), image
