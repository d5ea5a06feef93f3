"""The frame store: each camera's frames by its own clock, decoded once and kept as JPEG, and what forms an instant.

A folder with ``frames.parquet`` (one row per frame: ``camera_id``, ``local_ns``, its presentation timestamp in the
recording, ``offset``, ``length`` and ``crc32`` of its JPEG file; a length of 0 says that the recording is damaged
there), ``instants.parquet`` (`wibam_core.formats.instants`), ``cameras.json`` (sizes) and one ``<camera id>.jpegs`` per
camera: its JPEG files end to end. Tens of thousands of small files would be slow to make, copy and delete.
``frames.parquet`` is written last: a folder without one is not finished.
"""

from __future__ import annotations

import json
import os
import threading
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wibam_core.errors import InputError
from wibam_core.formats.instants import read_instants, write_instants
from wibam_core.geometry.pixels import resized_px, scale_of
from wibam_core.scene import FrameSet

Image = NDArray[np.uint8]
Size = tuple[int, int]

_FRAMES, _INSTANTS, _CAMERAS, _PACK = "frames.parquet", "instants.parquet", "cameras.json", "{}.jpegs"
_SCHEMA = pa.schema(
    [
        pa.field("camera_id", pa.string(), nullable=False),
        pa.field("local_ns", pa.int64(), nullable=False),
        pa.field("offset", pa.int64(), nullable=False),
        pa.field("length", pa.int64(), nullable=False),
        pa.field("crc32", pa.int64(), nullable=False),
    ]
)


class _Place(NamedTuple):
    """Where in its camera's file a JPEG lies."""

    offset: int
    length: int
    crc32: int


@dataclass(frozen=True)
class _Sizes:
    width_px: int
    height_px: int
    native_width_px: int
    native_height_px: int


@dataclass
class _Pack:
    """One camera's JPEG file being written."""

    file: BinaryIO
    size: Size
    bytes: int = 0
    places: dict[int, _Place] = field(default_factory=dict)


class FrameStoreWriter:
    """Writes a frame store with flat memory. Different cameras may be added from different threads.

    Args:
        folder: made if absent.
        jpeg_quality: 1 to 100.
    """

    def __init__(self, folder: Path, jpeg_quality: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._parameters = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
        self._packs: dict[str, _Pack] = {}
        self._instants: dict[int, dict[str, tuple[int, int]]] = {}
        self._damaged: dict[str, set[int]] = {}
        self._lock = threading.Lock()

    def add(
        self, camera_id: str, time_ns: int, frame_time_ns: int, image_bgr: Image, jpeg: bytes | None = None
    ) -> None:
        """Store a frame of a camera that keeps the reference clock, and let it belong to an instant.

        Args:
            camera_id: as in `add_frame`.
            time_ns: the instant.
            frame_time_ns: when the frame was exposed.
            image_bgr: as in `add_frame`.
            jpeg: the image as a JPEG file, where it came as one: it is stored as it is.
        """
        if jpeg is None:
            self.add_frame(camera_id, frame_time_ns, image_bgr)
        else:
            self.add_jpeg(camera_id, frame_time_ns, jpeg, (image_bgr.shape[1], image_bgr.shape[0]))
        self.add_to_instant(time_ns, camera_id, frame_time_ns, frame_time_ns)

    def add_frame(self, camera_id: str, local_ns: int, image_bgr: Image) -> None:
        """Store a camera's frame. One that is there already stays.

        Args:
            camera_id: plain, as `wibam_core.site.CameraId`: it names a file.
            local_ns: when the frame was exposed, on the camera's own clock.
            image_bgr: (H, W, 3) uint8, all of a camera's of one size.
        """
        height, width = image_bgr.shape[:2]
        pack = self._pack(camera_id, (width, height))
        if local_ns not in pack.places:
            done, data = cv2.imencode(".jpg", image_bgr, self._parameters)
            if not done:
                raise ValueError(f"a frame of shape {image_bgr.shape} and type {image_bgr.dtype} cannot be stored")
            self._append(pack, local_ns, data.tobytes())

    def add_jpeg(self, camera_id: str, local_ns: int, jpeg: bytes, size: Size) -> None:
        """As `add_frame`, of a JPEG file of this size (width, height) px."""
        pack = self._pack(camera_id, size)
        if local_ns not in pack.places:
            self._append(pack, local_ns, jpeg)

    def add_damaged(self, camera_id: str, times_ns: Iterable[int]) -> None:
        """Say which frames of a recording, by their times on the camera's own clock, cannot be decoded."""
        with self._lock:
            self._damaged.setdefault(camera_id, set()).update(times_ns)

    def add_to_instant(self, time_ns: int, camera_id: str, local_ns: int, frame_time_ns: int) -> None:
        """Let a frame belong to an instant.

        Args:
            time_ns: the instant, reference clock.
            camera_id: whose frame.
            local_ns: when it was exposed, on the camera's own clock.
            frame_time_ns: the same on the reference clock.
        """
        with self._lock:
            self._instants.setdefault(time_ns, {})[camera_id] = (frame_time_ns, local_ns)

    @property
    def bytes_written(self) -> int:
        """Size of all images so far, bytes."""
        with self._lock:
            return sum(pack.bytes for pack in self._packs.values())

    def close(self, native_sizes: Mapping[str, Size] | None = None) -> None:
        """Finish the store.

        Args:
            native_sizes: camera id -> (width, height) px of the recording; cameras left out were not resized.
        """
        self._close_files()
        native = native_sizes or {}
        sizes = {id_: _Sizes(*pack.size, *native.get(id_, pack.size)) for id_, pack in sorted(self._packs.items())}
        (self._folder / _CAMERAS).write_text(json.dumps({id_: asdict(s) for id_, s in sizes.items()}, indent=1))
        instants = [
            FrameSet(
                time_ns,
                {camera_id: frame_time_ns for camera_id, (frame_time_ns, _) in frames.items()},
                {camera_id: local_ns for camera_id, (_, local_ns) in frames.items()},
            )
            for time_ns, frames in self._instants.items()
        ]
        write_instants(self._folder / _INSTANTS, instants)
        rows = [
            (id_, local_ns, place.offset, place.length, place.crc32)
            for id_, pack in self._packs.items()
            for local_ns, place in pack.places.items()
        ]
        rows += [(id_, local_ns, 0, 0, 0) for id_, times_ns in self._damaged.items() for local_ns in times_ns]
        columns = zip(*sorted(rows), strict=True) if rows else [[] for _ in _SCHEMA]
        arrays = [pa.array(column, type=field.type) for column, field in zip(columns, _SCHEMA, strict=True)]
        pq.write_table(pa.table(arrays, schema=_SCHEMA), self._folder / _FRAMES, compression="zstd")

    def _pack(self, camera_id: str, size: Size) -> _Pack:
        with self._lock:
            if camera_id not in self._packs:
                self._packs[camera_id] = _Pack((self._folder / _PACK.format(camera_id)).open("wb"), size)
            pack = self._packs[camera_id]
        if size != pack.size:
            raise ValueError(f"camera {camera_id} has frames of {pack.size} px, not {size} px")
        return pack

    @staticmethod
    def _append(pack: _Pack, local_ns: int, jpeg: bytes) -> None:
        pack.file.write(jpeg)
        pack.places[local_ns] = _Place(pack.bytes, len(jpeg), zlib.crc32(jpeg))
        pack.bytes += len(jpeg)

    def _close_files(self) -> None:
        for pack in self._packs.values():
            pack.file.close()

    def __enter__(self) -> FrameStoreWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Release the files. Only `close` finishes the store."""
        self._close_files()


class FrameStore:
    """Reads a frame store.

    Attributes:
        folder: where it lies.
        camera_ids: cameras that have frames, sorted.

    Raises:
        InputError: the folder holds no finished frame store.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            sizes = json.loads((folder / _CAMERAS).read_text())
            table = pq.read_table(folder / _FRAMES, schema=_SCHEMA)
        except (OSError, ValueError, pa.ArrowInvalid) as error:
            raise InputError(
                f"{folder.name} holds no finished frame store: {error}", hint="Run the frames stage again."
            ) from error
        self._sizes = {id_: _Sizes(**values) for id_, values in sizes.items()}
        self.camera_ids: tuple[str, ...] = tuple(self._sizes)
        cameras = table["camera_id"].to_numpy()
        places = np.stack([table[name].to_numpy() for name in _SCHEMA.names[1:]])
        #: By camera (4, N): times, ascending, then where their JPEG files lie.
        self._places = {id_: places[:, cameras == id_] for id_ in table["camera_id"].unique().to_pylist()}
        self._packs: dict[str, BinaryIO] = {}

    @cached_property
    def frame_sets(self) -> list[FrameSet]:
        """All instants, ascending."""
        return read_instants(self.folder / _INSTANTS)

    @cached_property
    def _instants(self) -> dict[int, FrameSet]:
        return {instant.time_ns: instant for instant in self.frame_sets}

    def __len__(self) -> int:
        return len(self.frame_sets)

    def __reduce__(self) -> tuple[type[FrameStore], tuple[Path]]:
        return FrameStore, (self.folder,)

    def thinned(self, rate_hz: float) -> list[FrameSet]:
        """Instants at most ``rate_hz`` a second: the first at or after each multiple of the period."""
        period_ns = 1e9 / rate_hz
        kept: list[FrameSet] = []
        last = None
        for instant in self.frame_sets:
            # half a microsecond of tolerance: sampling periods are rounded to whole ns
            slot = int((instant.time_ns + 500) // period_ns)
            if slot != last:
                kept.append(instant)
                last = slot
        return kept

    def has(self, camera_id: str, time_ns: int) -> bool:
        """Whether the camera has a frame for the instant."""
        return time_ns in self._instants and camera_id in self._instants[time_ns].local_times_ns

    def image(self, camera_id: str, time_ns: int) -> Image:
        """A camera's frame (H, W, 3) uint8, BGR, for the instant ``time_ns`` of a frame set.

        Raises:
            KeyError: the camera has no frame for that instant.
            InputError: the stored frame is damaged.
        """
        return self.image_at(camera_id, self._instants[time_ns].local_times_ns[camera_id])

    def image_at(self, camera_id: str, local_ns: int) -> Image:
        """As `image`, by the time on the camera's own clock."""
        image = cv2.imdecode(np.frombuffer(self.jpeg_at(camera_id, local_ns), np.uint8), cv2.IMREAD_COLOR_BGR)
        if image is None:
            raise _damaged(camera_id, local_ns)
        return np.asarray(image, dtype=np.uint8)

    def jpeg_at(self, camera_id: str, local_ns: int) -> bytes:
        """As `image_at`, as a JPEG file."""
        times_ns, offsets, lengths, checksums = self._places[camera_id]
        at = np.searchsorted(times_ns, local_ns)
        if at == len(times_ns) or times_ns[at] != local_ns or not lengths[at]:
            raise KeyError(local_ns)
        # a mapped file would count as memory of the process, more and more as its frames are read
        pack = self._pack(camera_id)
        jpeg = os.pread(pack.fileno(), int(lengths[at]), int(offsets[at]))
        if zlib.crc32(jpeg) != checksums[at]:
            raise _damaged(camera_id, local_ns)
        return jpeg

    def stored_ns(self, camera_id: str) -> NDArray[np.int64]:
        """(N,) times of all of a camera's stored frames on its own clock, ascending."""
        times_ns, _, lengths, _ = self._places[camera_id]
        return times_ns[lengths > 0]

    def damaged_ns(self, camera_id: str) -> NDArray[np.int64]:
        """(N,) times, on the camera's own clock, at which its recording is known to be damaged, ascending."""
        times_ns, _, lengths, _ = self._places.get(camera_id, np.empty((4, 0), np.int64))
        return times_ns[lengths == 0]

    def size(self, camera_id: str) -> Size:
        """(width, height) px of the stored frames."""
        sizes = self._sizes[camera_id]
        return sizes.width_px, sizes.height_px

    def native_size(self, camera_id: str) -> Size:
        """(width, height) px of the recording."""
        sizes = self._sizes[camera_id]
        return sizes.native_width_px, sizes.native_height_px

    def to_native_px(self, camera_id: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of stored frames to pixels of the recording.

        Args:
            camera_id: whose pixels.
            points: (..., 2k) alternating u, v: points, or xyxy boxes.

        Returns:
            The same shape.
        """
        return resized_px(points, scale_of(self.size(camera_id), self.native_size(camera_id), points.shape[-1]))

    def to_stored_px(self, camera_id: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of the recording to pixels of stored frames, the inverse of `to_native_px`."""
        return resized_px(points, scale_of(self.native_size(camera_id), self.size(camera_id), points.shape[-1]))

    def _pack(self, camera_id: str) -> BinaryIO:
        if camera_id not in self._packs:
            try:
                pack = (self.folder / _PACK.format(camera_id)).open("rb")
            except OSError as error:
                raise InputError(
                    f"the stored frames of camera {camera_id} cannot be read: {error}",
                    hint="Run the frames stage again.",
                ) from error
            # of two threads that open it at one time, one file stays
            return self._packs.setdefault(camera_id, pack)
        return self._packs[camera_id]


def _damaged(camera_id: str, local_ns: int) -> InputError:
    return InputError(
        f"the stored frame of camera {camera_id} at {local_ns} ns of its clock is damaged",
        hint="Run the frames stage again.",
    )
