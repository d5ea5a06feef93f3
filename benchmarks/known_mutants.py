"""Mistakes that once passed the tests unseen. Each is a change to one line, and the tests that ought to fail for it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mistake:
    """One wrong line.

    Attributes:
        name: what goes wrong, in a few words.
        path: of the source file, relative to the project's root.
        right, wrong: text that stands exactly once in the file, and what takes its place.
        tests: files or folders of tests that ought to notice.
    """

    name: str
    path: str
    right: str
    wrong: str
    tests: tuple[str, ...]


KNOWN = (
    Mistake(
        "the baseline has the fine-tuned weights",
        "wibam_core/stages/evaluate.py",
        "baseline = load_to_detect(start, device, card.input_width_px)",
        "baseline = load_to_detect(context.read(WEIGHTS), device, card.input_width_px)",
        ("tests/unit/stages/test_evaluate_and_track.py",),
    ),
    Mistake(
        "the tracker is not told when frames were exposed",
        "wibam_core/stages/track.py",
        "tracker.step(time_ns, of_instant, frame_times[time_ns])",
        "tracker.step(time_ns, of_instant)",
        ("tests/unit/stages/test_evaluate_and_track.py",),
    ),
    Mistake(
        "significance compares with another way to place boxes",
        "wibam_core/stages/evaluate.py",
        'significance(correct["baseline"], correct["finetuned"])',
        "significance(list(correct.values())[-2], list(correct.values())[-1])",
        ("tests/unit/stages/test_evaluate_and_track.py",),
    ),
    Mistake(
        "benchmarks evaluate frames at the instant, not when they were exposed",
        "benchmarks/learning_sites.py",
        "at_exposure = [replace(v, time_ns=exposed[v.time_ns, str(v.camera_id)]) for v in found]\n    return evaluate(",
        "at_exposure = list(found)\n    return evaluate(",
        ("tests/unit/benchmarks",),
    ),
    Mistake(
        "benchmarks train on vehicles that the split leaves out",
        "benchmarks/learning_sites.py",
        "left_out = site.split.left_out_tracks[part]",
        "left_out = frozenset()",
        ("tests/unit/benchmarks",),
    ),
    Mistake(
        "the best weights are never kept",
        "wibam_core/training/finetune.py",
        "worse = bool(self._epochs[-1].validation) and",
        "worse = False and",
        ("tests/unit/training/test_finetune.py",),
    ),
    Mistake(
        "the published method is shaken too",
        "wibam_core/training/batches.py",
        'self._config.method != "paper" and rng.random() < SHAKEN_SHARE',
        "rng.random() < SHAKEN_SHARE",
        ("tests/unit/training/test_finetune.py",),
    ),
    Mistake(
        "overlooked vehicles that teach nothing are taught as background",
        "wibam_core/training/dataset.py",
        "missed.boxes2d[~taught], missed.unsure]",
        "missed.unsure]",
        ("tests/unit/training/test_overlooked.py", "tests/unit/training/test_dataset.py"),
    ),
    Mistake(
        "a sign in the motion model's Jacobian",
        "wibam_core/tracking/driving.py",
        "F[..., X, YAW], F[..., Y, YAW] = -chord * s, chord * c",
        "F[..., X, YAW], F[..., Y, YAW] = chord * s, chord * c",
        ("tests/unit/tracking/test_motion.py",),
    ),
    Mistake(
        "the motion model's curvature turns the other way",
        "wibam_core/tracking/driving.py",
        "F[..., YAW, SPEED], F[..., YAW, CURVATURE] = curvature * dt, chord",
        "F[..., YAW, SPEED], F[..., YAW, CURVATURE] = curvature * dt, -chord",
        ("tests/unit/tracking/test_motion.py",),
    ),
    Mistake(
        "spreads are ignored in the means of clusters",
        "wibam_core/association/dpmeans.py",
        "    information = _inverse(spreads)\n",
        "    information = _inverse(np.broadcast_to(np.eye(2), spreads.shape))\n",
        ("tests/unit/association/test_dpmeans.py",),
    ),
    Mistake(
        "a second box of a vehicle must all but coincide to count as one",
        "wibam_core/tracking/tracker.py",
        "_DUPLICATE_IOU = 0.1",
        "_DUPLICATE_IOU = 0.95",
        ("tests/unit/tracking/test_tracker.py",),
    ),
    Mistake(
        "clocks drift without a prior",
        "wibam_core/sync/offsets.py",
        "DRIFT_SD_PPM = 30.0",
        "DRIFT_SD_PPM = 30000.0",
        ("tests/unit/sync/test_offsets.py",),
    ),
    Mistake(
        "improbable conflicts are reported",
        "wibam_core/safety/conflicts.py",
        "conflict.probability >= config.min_probability:",
        "conflict.probability >= 0.0:",
        ("tests/unit/safety/test_conflicts.py",),
    ),
)
