"""New footage through a network that is there already: tracks, without training, however long it is.

The footage is read minute by minute. What a minute has settled is kept in the scratch folder, with all that the next
one needs, so that a run that was killed goes on where it was; and each minute is looked at for what is unusual: a
camera that was turned, a network that finds less, or is less sure, than where it was made.
"""

from __future__ import annotations

import ctypes
import gc
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from wibam_core.artifacts.catalogue import CALIBRATED_RIG, CLOCKS, OPEN_TRACKS, PROBE, TRACKS, WATCHED
from wibam_core.config import TrackConfig
from wibam_core.documents.watching import CameraTurned, CameraWatched, Stretch, Watched
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.formats.tracks import TrackWriter, span_of, to_table
from wibam_core.formats.usual import Usual, read_usual
from wibam_core.models.frames import Frame
from wibam_core.models.network import Network, predict
from wibam_core.networks.registry import load_to_detect
from wibam_core.scene import CameraRig, Track
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.footage import GAP_S, CameraFootage, Footage, SeenFrame
from wibam_core.tracking.one_per_camera import found_once
from wibam_core.tracking.stream import TrackStream, read_stream, write_stream
from wibam_core.watching.drift import doubts, looked_at
from wibam_core.watching.turn import Turn, turned
from wibam_core.watching.usual import Noticed

#: Footage is dealt with in pieces of so many seconds, which begin at multiples of that.
CHUNK_S = 60
_CHUNK_NS = CHUNK_S * 1_000_000_000
_STATE, _NOTED = "stream.npz", "noted.json"


@dataclass
class _Notes:
    """What is known after some of the footage; it is kept, so that a killed run can go on."""

    until_ns: int | None = None
    chunks: int = 0
    instants: int = 0
    counts: dict[str, tuple[int, int, float]] = field(default_factory=dict)
    turns: list[CameraTurned] = field(default_factory=list)
    classes: dict[int, str] = field(default_factory=dict)

    def to_json(self) -> str:
        return json.dumps(
            {
                "until_ns": self.until_ns,
                "chunks": self.chunks,
                "instants": self.instants,
                "counts": self.counts,
                "turns": [turn.model_dump() for turn in self.turns],
                "classes": self.classes,
            }
        )

    @classmethod
    def of_json(cls, text: str) -> _Notes:
        said = json.loads(text)
        return cls(
            said["until_ns"],
            said["chunks"],
            said["instants"],
            {camera_id: tuple(counts) for camera_id, counts in said["counts"].items()},
            [CameraTurned.model_validate(turn) for turn in said["turns"]],
            {int(track_id): name for track_id, name in said["classes"].items()},
        )


def run(context: StageContext, config: TrackConfig) -> Summary:
    """Write `TRACKS`, `OPEN_TRACKS` and `WATCHED`.

    Raises:
        InputError: the tracks to go on with are another version's.
        InvalidWeights: the network cannot be used.
    """
    watch = _Watch(context, config)
    for _ in watch.chunks():
        pass
    return watch.finish()


class _Watch:
    """One run, chunk by chunk."""

    def __init__(self, context: StageContext, config: TrackConfig) -> None:
        self._context, self._config = context, config
        self._rig = context.read(CALIBRATED_RIG)
        self._network: Network = load_to_detect(context.assets["model"])
        self._factors = SdFactors(**self._network.card.sd_factors)
        self._usual = read_usual(context.assets["usual"]) if "usual" in context.assets else Usual()
        infos, clocks = context.read(PROBE).cameras, context.read(CLOCKS)
        self._cameras = {
            camera_id: CameraFootage(camera_id, context.recordings[camera_id], info, clocks[camera_id])
            for camera_id, info in infos.items()
        }
        self._notes, self._stream = self._begin()
        for turn in self._notes.turns:
            if turn.corrected:
                self._turn(turn.camera, Turn(turn.rotation_rad, turn.patches, turn.agree, 0.0))
        self._footage = Footage(self._cameras, config.rate_hz, self._rig, self._notes.until_ns)

    # --- what a killed run left ----------------------------------------------------------------
    def _begin(self) -> tuple[_Notes, TrackStream]:
        scratch, config = self._context.scratch, self._config
        if (scratch / _NOTED).exists():
            notes = _Notes.of_json((scratch / _NOTED).read_text())
            return notes, read_stream(self._state(notes.chunks), config)
        return _Notes(), self._before() or TrackStream(config)

    def _before(self) -> TrackStream | None:
        """What the run before left to go on with; None where there was none."""
        assets = self._context.assets
        return read_stream(assets["open_tracks"], self._config) if "open_tracks" in assets else None

    def _state(self, chunk: int) -> Path:
        return self._context.scratch / f"{chunk}-{_STATE}"

    def _part(self, chunk: int) -> Path:
        return self._context.scratch / f"{chunk}.parquet"

    def _keep(self, tracks: Sequence[Track]) -> None:
        """Keep what one more chunk has settled; the notes come last, and count what is there."""
        notes = self._notes
        notes.chunks += 1
        notes.classes |= {track.track_id: track.vehicle_class.value for track in tracks}
        pq.write_table(_states_of(tracks), self._part(notes.chunks), compression="zstd")
        write_stream(self._state(notes.chunks), self._stream)
        partial = self._context.scratch / f"{_NOTED}.tmp"
        partial.write_text(notes.to_json())
        partial.replace(self._context.scratch / _NOTED)
        self._state(notes.chunks - 1).unlink(missing_ok=True)

    # --- chunk by chunk ------------------------------------------------------------------------
    def chunks(self) -> Iterator[int]:
        """Deal with one chunk after another; each time, how many there were."""
        instants = self._footage.instants
        first, total = (int(instants[0]), len(instants)) if len(instants) else (0, 1)
        done = 0
        frames = self._footage.frames()
        for _, of_chunk in groupby(frames, key=lambda frame: frame.instant_ns // _CHUNK_NS):
            noticed = Noticed(CHUNK_S)
            last_ns = self._chunk(of_chunk, noticed)
            done = int(np.searchsorted(instants, last_ns, side="right"))
            self._look(noticed, last_ns)
            self._notes.until_ns = last_ns
            self._keep(self._stream.settled())
            self._context.progress(
                done / total,
                f"{(last_ns - first) / 6e10:.0f} min of footage, {len(self._notes.classes)} tracks",
                tracks=float(len(self._notes.classes)),
            )
            _give_back_memory()
            yield self._notes.chunks

    def _chunk(self, seen: Iterator[SeenFrame], noticed: Noticed) -> int:
        """Search one chunk's frames and follow what is in them; returns the last instant."""
        exposed: dict[int, dict[str, int]] = {}

        def frames() -> Iterator[Frame]:
            for frame in seen:
                exposed.setdefault(frame.instant_ns, {})[frame.camera_id] = frame.exposed_ns
                noticed.see(frame.camera_id, frame.instant_ns, frame.image)
                yield Frame(frame.image, self._rig[frame.camera_id], frame.camera_id, frame.instant_ns)

        found = predict(self._network, frames(), decode=self._network.card.decode, min_score=self._config.min_score)
        time_ns = 0
        for time_ns, of_instant in groupby(found, key=lambda vehicles: vehicles.time_ns):
            detections = [self._factors.apply(vehicles) for vehicles in of_instant]
            for vehicles in detections:
                noticed.find(str(vehicles.camera_id), vehicles.scores)
            if self._rig.views:
                detections = found_once(detections, self._rig, self._config.fusion_radius_m)
            self._stream.step(time_ns, detections, exposed.pop(time_ns))
            self._notes.instants += 1
        return time_ns

    def _look(self, noticed: Noticed, time_ns: int) -> None:
        """Compare a chunk with what is usual; a small turn is corrected from here on."""
        now = noticed.usual()
        for camera_id, found in now.found.items():
            images, boxes, total = self._notes.counts.get(camera_id, (0, 0, 0.0))
            score = found.score * found.boxes if found.boxes else 0.0
            self._notes.counts[camera_id] = (images + found.images, boxes + found.boxes, total + score)
        for turn, look in looked_at(self._usual.stills, now.stills, self._rig, time_ns, self._notes.turns):
            self._notes.turns.append(look)
            if look.corrected:
                self._turn(look.camera, turn)

    def _turn(self, camera_id: str, turn: Turn) -> None:
        """Use the camera as it is turned now; ``turn`` is from where it pointed when it was calibrated."""
        calibrated = self._context.read(CALIBRATED_RIG)
        cameras = dict(self._rig.mounted)
        cameras[camera_id] = turned(calibrated.mounted[camera_id], turn)
        self._rig = CameraRig(cameras, self._rig.views)

    # --- the end -------------------------------------------------------------------------------
    def finish(self) -> Summary:
        """Write all outputs."""
        self._keep(self._stream.ended())
        notes, context = self._notes, self._context
        with TrackWriter(context.new_file(TRACKS)) as writer:
            parts = [self._part(number) for number in range(1, notes.chunks + 1)]
            for part, to_come_ns in zip(parts, _earliest_to_come(parts), strict=True):
                writer.add(pq.read_table(part))
                writer.settle(to_come_ns)
            writer.settle()
        write_stream(context.new_file(OPEN_TRACKS), self._stream)
        document = self._document()
        context.write(WATCHED, document)
        context.warn(*doubts(document, sorted(self._usual.stills.keys() & self._rig.keys())))
        context.progress(1.0)
        return {
            "tracks": document.tracks,
            "instants": document.instants,
            "by_class": document.by_class,
            "footage_s": {
                camera_id: round(sum(s.to_ns - s.from_ns for s in camera.footage) / 1e9, 1)
                for camera_id, camera in document.cameras.items()
            },
            "gaps": {camera_id: len(camera.gaps) for camera_id, camera in document.cameras.items()},
        }

    def _document(self) -> Watched:
        notes = self._notes
        cameras = {id_: self._camera(id_, camera) for id_, camera in self._cameras.items()}
        ends = [(stretch.from_ns, stretch.to_ns) for camera in cameras.values() for stretch in camera.footage]
        start_ns, dated = (
            min(start for start, _ in ends),
            all(camera.recording.is_dated for camera in self._cameras.values()),
        )
        before = self._before()
        before_ns = None if before is None or not dated else before.last_ns
        missed = before_ns is not None and start_ns - before_ns >= GAP_S * 1e9
        return Watched(
            start_ns=start_ns,
            end_ns=max(end for _, end in ends),
            dated=dated,
            instants=notes.instants,
            cameras=cameras,
            turns=notes.turns,
            tracks=len(notes.classes),
            by_class=dict(sorted(Counter(notes.classes.values()).items())),
            continued=before is not None,
            missed_before=Stretch(from_ns=before_ns, to_ns=start_ns) if missed and before_ns is not None else None,
        )

    def _camera(self, camera_id: str, camera: CameraFootage) -> CameraWatched:
        stretches = camera.stretches
        gaps = [Stretch(from_ns=a.to_ns, to_ns=b.from_ns) for a, b in pairwise(stretches)]
        views = [view.id for view in self._rig.views.get(camera_id, ())] or [camera_id]
        counts = np.array([self._notes.counts.get(view, (0, 0, 0.0)) for view in views]).sum(axis=0)
        usual = [self._usual.found[view] for view in views if view in self._usual.found]
        usual_boxes = sum(found.boxes for found in usual)
        scores = sum(found.boxes * found.score for found in usual if found.boxes)
        return CameraWatched(
            footage=stretches,
            gaps=gaps,
            images=int(counts[0]),
            boxes=int(counts[1]),
            score=float(counts[2] / counts[1]) if counts[1] else None,
            usual_score=scores / usual_boxes if usual_boxes else None,
            usual_boxes_an_image=usual_boxes / max(sum(found.images for found in usual), 1) if usual else None,
        )


def _give_back_memory() -> None:
    """Let the system have what is free: closed decoders wait in cycles of objects, and freed pictures in the heap."""
    gc.collect()
    with suppress(OSError, AttributeError):  # not glibc
        ctypes.CDLL(None).malloc_trim(0)


def _states_of(tracks: Sequence[Track]) -> pa.Table:
    """States of pieces of tracks, of which several may have one id."""
    return pa.concat_tables([to_table([]), *(to_table([track]) for track in tracks)])


def _earliest_to_come(parts: Sequence[Path]) -> list[int | None]:
    """Of each part, the first time in all parts after it; None where nothing comes."""
    found: list[int | None] = []
    earliest: int | None = None
    for part in reversed(parts):
        found.append(earliest)
        span = span_of(part)
        if span is not None:
            earliest = span[0] if earliest is None else min(span[0], earliest)
    return found[::-1]
