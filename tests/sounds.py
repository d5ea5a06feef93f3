"""What microphones at a street record, and recordings with it."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RATE_HZ = 16_000
SOUND_MPS = 343.0
#: Where the microphones hang, m; 38 m from each other.
MICROPHONES_M = np.array([[-15.0, -12.0], [14.0, 13.0]])


def street(
    rng: np.random.Generator,
    seconds: float,
    *,
    every_s: float = 4.0,
    places_m: Array = MICROPHONES_M,
    noise: float = 0.003,
) -> list[Array]:
    """What is heard at each place: horns, doors and brakes from anywhere, now and then, and vehicles that pass."""
    count = round(seconds * RATE_HZ)
    heard = [rng.normal(size=count) * noise for _ in places_m]
    for begin_s in np.cumsum(rng.exponential(every_s, round(3 * seconds / every_s) + 10)):
        lasts = round(rng.choice([0.03, 0.1, 0.4]) * RATE_HZ)
        source, times = rng.uniform(-25, 25, 2), np.arange(lasts)
        burst = rng.normal(size=lasts) * np.exp(-3 * times / lasts)
        if rng.random() < 0.3:
            tone = np.sign(np.sin(2 * np.pi * rng.uniform(350, 500) * times / RATE_HZ))
            burst = tone * np.minimum(1.0, times / 200)
        burst *= 0.5 * 10 ** rng.normal(0, 0.4)
        for samples, place in zip(heard, places_m, strict=True):
            away_m = max(float(np.hypot(*(source - place))), 2.0)
            at = round((begin_s + away_m / SOUND_MPS) * RATE_HZ)
            if at + lasts < count:
                samples[at : at + lasts] += burst / away_m
    for passes_s in np.cumsum(rng.exponential(5.0, round(seconds / 5 * 3) + 10)):
        speed_mps = rng.uniform(8, 14) * rng.choice([-1, 1])
        low, high = (round(min(max(passes_s + by, 0), seconds) * RATE_HZ) for by in (-5, 5))
        along_m = speed_mps * (np.arange(low, high) / RATE_HZ - passes_s)
        for samples, place in zip(heard, places_m, strict=True):
            away_m = np.sqrt((along_m - place[0]) ** 2 + (place[1] - 2) ** 2 + 36)
            samples[low:high] += rng.normal(size=high - low) * 0.2 / away_m
    return heard


def wind(rng: np.random.Generator, seconds: float) -> Array:
    """Wind in a microphone: deep noise in gusts."""
    count = round(seconds * RATE_HZ)
    gusts = np.repeat(np.exp(rng.normal(0, 0.8, count // 4000 + 1)), 4000)[:count]
    deep = np.convolve(rng.normal(size=count), 0.97 ** np.arange(200), "same")
    return np.asarray(0.02 * gusts * deep)


def music(rng: np.random.Generator, seconds: float, every_s: float = 0.25) -> Array:
    """Four sounds in turn, at an even beat."""
    length = round(0.08 * RATE_HZ)
    kinds = rng.normal(size=(4, length)) * np.exp(-5 * np.arange(length) / length)
    samples = rng.normal(size=round(seconds * RATE_HZ)) * 0.003
    for beat in range(round(seconds / every_s) - 1):
        at = round(beat * every_s * RATE_HZ)
        samples[at : at + length] += 0.05 * kinds[beat % 4]
    return samples


def of_camera(samples: Array, begin_s: float, seconds: float, drift: float = 0.0) -> Array:
    """What a recording that begins then holds, whose clock runs faster by ``drift``."""
    times = begin_s + np.arange(round(seconds * RATE_HZ)) / RATE_HZ / (1 + drift)
    return np.interp(times * RATE_HZ, np.arange(len(samples)), samples)


def add_sound(
    source: Path,
    path: Path,
    tracks: Sequence[Array],
    *,
    codec: str = "aac",
    sample_format: str = "fltp",
    begin_s: float = 0.0,
    rate_hz: int = RATE_HZ,
    **options: str,
) -> Path:
    """The pictures of a recording as they are, and sound that begins ``begin_s`` on the recording's clock."""
    with av.open(str(source)) as opened, av.open(str(path), "w", options=options) as output:
        pictures = opened.streams.video[0]
        copied = output.add_stream_from_template(pictures)
        added = [output.add_stream(codec, rate=rate_hz, layout="mono", format=sample_format) for _ in tracks]
        packets = []
        for packet in opened.demux(pictures):
            if packet.size:
                packet.stream = copied
                packets.append(packet)
        for stream, samples in zip(added, tracks, strict=True):
            for begin in range(0, len(samples), 1024):
                frame = av.AudioFrame.from_ndarray(
                    samples[None, begin : begin + 1024].astype(np.float32), "fltp", "mono"
                )
                frame.sample_rate, frame.time_base = rate_hz, Fraction(1, rate_hz)
                frame.pts = begin + round(begin_s * rate_hz)
                packets += stream.encode(frame)
            packets += stream.encode(None)
        for packet in sorted(packets, key=lambda one: float((one.dts or 0) * one.time_base)):
            output.mux(packet)
    return path
