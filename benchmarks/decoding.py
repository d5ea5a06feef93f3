"""What it costs to read a 1440p50 recording: every 4th frame, shrunk, and signal heads in every frame.

Every 4th frame is taken against libavcodec and swscale alone, the signal heads (two windows of 30 x 60 px, as they look
in the whole picture) against libavcodec alone, and against converting every frame as a whole.

The bare work is what ffmpeg does with the filters select and scale (flags area, accurate_rnd, full_chroma_int) to raw
BGR: decode every frame on one thread, and shrink and convert one in four. Both read one file, made here, in turn, round
by round; printed are the medians of CPU time of one thread a frame that is decoded, and of the rounds' ratios. What
opening the file costs, a tenth of a second, is part of it.

Run: OMP_NUM_THREADS=1 python benchmarks/decoding.py [--rounds 5] [--frames 500] [--width 1920]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np

from wibam_core.video.decode import OnePass, Watcher, decode, frames_nearest
from wibam_core.video.encode import VideoWriter
from wibam_core.video.source import ACCURATE_BY_AREA

WIDTH_PX, HEIGHT_PX, FPS = 2560, 1440, 50
EVERY = 4
#: Windows of signal heads, px.
HEADS = [(500, 300, 530, 360), (1600, 300, 1630, 360)]


def make_recording(path: Path, frames: int) -> None:
    """A still background with a sensor's noise, and things that move before it."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (HEIGHT_PX // 40, WIDTH_PX // 40, 3), dtype=np.uint8)
    still = cv2.resize(coarse, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_CUBIC)
    noise = rng.normal(0, 2, (4, HEIGHT_PX, WIDTH_PX, 3)).astype(np.int16)
    with VideoWriter(path, WIDTH_PX, HEIGHT_PX, FPS) as writer:
        for number in range(frames):
            image = still.copy()
            for k in range(20):
                left, top = (97 * k + 9 * number) % (WIDTH_PX - 200), 70 * k % (HEIGHT_PX - 120)
                image[top : top + 90, left : left + 180] = (40 * k % 255, 255 - 12 * k, 90)
            noisy = np.clip(image + noise[number % len(noise)], 0, 255).astype(np.uint8)
            writer.write(noisy, round(number * 1e9 / FPS))


def bare(path: Path, width_px: int, _: int) -> int:
    """Decode all frames, shrink and convert one in four; returns how many."""
    taken, height_px = 0, width_px * HEIGHT_PX // WIDTH_PX
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.codec_context.thread_count = 1
        for number, frame in enumerate(container.decode(stream)):
            if number % EVERY == 0:
                frame.to_ndarray(width=width_px, height=height_px, format="bgr24", interpolation=ACCURATE_BY_AREA)
                taken += 1
    return taken


def ours(path: Path, width_px: int, wanted: int) -> int:
    """The same by the times of the frames, as stages read recordings."""
    step_ns = EVERY * 1_000_000_000 // FPS
    times_ns = range(0, wanted * step_ns, step_ns)
    return sum(1 for _ in frames_nearest(path, times_ns, tolerance_ns=1_000_000, width_px=width_px))


def decoded(path: Path, _: int, __: int) -> int:
    """Decode all frames and do nothing with them; returns how many."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        stream.codec_context.thread_count = 1
        return sum(1 for _ in container.decode(stream))


def heads(path: Path, _: int, __: int) -> int:
    """Look at the signal heads in every frame, as `sync` does; returns how many frames."""
    shown: list[int] = []
    watcher = Watcher(HEADS, (WIDTH_PX, HEIGHT_PX), lambda time_ns, _: shown.append(time_ns))
    OnePass(path, watcher=watcher).finish()
    return len(shown)


def whole(path: Path, _: int, __: int) -> int:
    """Convert every frame; returns how many."""
    return sum(1 for _ in decode(path))


def cpu_s(work: Callable[[Path, int, int], int], path: Path, width_px: int, wanted: int) -> float:
    start = time.process_time()
    taken = work(path, width_px, wanted)
    assert taken == wanted, f"{work.__name__} took {taken} frames, not {wanted}"
    return time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--width", type=int, default=1920, help="of the frames that are taken, px")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "recording.mp4"
        make_recording(path, arguments.frames)
        wanted = -(-arguments.frames // EVERY)
        works = {
            bare: wanted,
            ours: wanted,
            decoded: arguments.frames,
            heads: arguments.frames,
            whole: arguments.frames,
        }
        cpu_s(bare, path, arguments.width, wanted)  # warms up
        taken = [
            [cpu_s(work, path, arguments.width, frames) for work, frames in works.items()]
            for _ in range(arguments.rounds)
        ]
    rounds = dict(zip((work.__name__ for work in works), np.array(taken).T, strict=True))
    for name, seconds in rounds.items():
        print(f"{name}: {1e3 * np.median(seconds) / arguments.frames:.2f} ms a frame")
    for name, beside in (("ours", "bare"), ("heads", "decoded"), ("whole", "decoded")):
        print(f"{name} / {beside}: {np.median(rounds[name] / rounds[beside]):.3f}")


if __name__ == "__main__":
    main()
