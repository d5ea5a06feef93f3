"""The frame store: the frames of all instants, decoded once and kept as JPEG.

A folder with ``index.parquet`` (one row per instant and camera: ``camera_id``, ``time_ns``, ``frame_time_ns``,
``offset``, ``length``), ``cameras.json`` (sizes) and one ``<camera id>.jpegs`` per camera: its JPEG files end to end.
Tens of thousands of small files would be slow to make, copy and delete. The index is written last: a folder without
one is not finished.
"""

from __future__ import annotations

import json
import mmap
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from wibam_core.errors import InputError
from wibam_core.geometry.pixels import resized_px, scale_of
from wibam_core.scene import FrameSet

Image = NDArray[np.uint8]
Size = tuple[int, int]

_INDEX, _CAMERAS, _PACK = "index.parquet", "cameras.json", "{}.jpegs"
_SCHEMA = pa.schema(
    [
        pa.field("time_ns", pa.int64(), nullable=False),
        pa.field("camera_id", pa.string(), nullable=False),
        pa.field("frame_time_ns", pa.int64(), nullable=False),
        pa.field("offset", pa.int64(), nullable=False),
        pa.field("length", pa.int64(), nullable=False),
    ]
)


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
    last_frame_ns: int | None = None
    place: tuple[int, int] = (0, 0)


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
        self._rows: list[tuple[int, str, int, int, int]] = []
        self._lock = threading.Lock()

    def add(
        self, camera_id: str, time_ns: int, frame_time_ns: int, image_bgr: Image, jpeg: bytes | None = None
    ) -> None:
        """Store a camera's frame for an instant. The same frame for two instants in a row is stored once.

        Args:
            camera_id: plain, as `wibam_core.site.CameraId`: it names a file.
            time_ns: the instant.
            frame_time_ns: when the frame was exposed, reference clock.
            image_bgr: (H, W, 3) uint8, all of a camera's of one size.
            jpeg: the image as a JPEG file, where it came as one: it is stored as it is.
        """
        height, width = image_bgr.shape[:2]
        with self._lock:
            if camera_id not in self._packs:
                file = (self._folder / _PACK.format(camera_id)).open("wb")
                self._packs[camera_id] = _Pack(file, (width, height))
            pack = self._packs[camera_id]
        if (width, height) != pack.size:
            raise ValueError(f"camera {camera_id} has frames of {pack.size} px, not {(width, height)} px")
        if frame_time_ns != pack.last_frame_ns:
            data = self._encoded(image_bgr) if jpeg is None else jpeg
            pack.place = (sum(pack.place), len(data))
            pack.last_frame_ns = frame_time_ns
            pack.file.write(data)
        with self._lock:
            self._rows.append((time_ns, camera_id, frame_time_ns, *pack.place))

    def _encoded(self, image_bgr: Image) -> bytes:
        done, data = cv2.imencode(".jpg", image_bgr, self._parameters)
        if not done:
            raise ValueError(f"a frame of shape {image_bgr.shape} and type {image_bgr.dtype} cannot be stored")
        return data.tobytes()

    def close(self, native_sizes: Mapping[str, Size] | None = None) -> None:
        """Finish the store.

        Args:
            native_sizes: camera id -> (width, height) px of the recording; cameras left out were not resized.
        """
        self._close_files()
        native = native_sizes or {}
        sizes = {id_: _Sizes(*pack.size, *native.get(id_, pack.size)) for id_, pack in sorted(self._packs.items())}
        (self._folder / _CAMERAS).write_text(json.dumps({id_: asdict(s) for id_, s in sizes.items()}, indent=1))
        columns = zip(*sorted(self._rows), strict=True) if self._rows else [[] for _ in _SCHEMA]
        arrays = [pa.array(column, type=field.type) for column, field in zip(columns, _SCHEMA, strict=True)]
        pq.write_table(pa.table(arrays, schema=_SCHEMA), self._folder / _INDEX, compression="zstd")

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
        frame_sets: all instants, ascending.

    Raises:
        InputError: the folder holds no finished frame store.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            sizes = json.loads((folder / _CAMERAS).read_text())
            table = pq.read_table(folder / _INDEX, schema=_SCHEMA)
        except (OSError, ValueError, pa.ArrowInvalid) as error:
            raise InputError(
                f"{folder.name} holds no finished frame store: {error}", hint="Run the frames stage again."
            ) from error
        self._sizes = {id_: _Sizes(**values) for id_, values in sizes.items()}
        self.camera_ids: tuple[str, ...] = tuple(self._sizes)
        self._places: dict[tuple[str, int], tuple[int, int]] = {}
        frames: dict[int, dict[str, int]] = {}
        for time_ns, camera_id, frame_time_ns, offset, length in zip(
            *(column.to_pylist() for column in table.columns), strict=True
        ):
            frames.setdefault(time_ns, {})[camera_id] = frame_time_ns
            self._places[camera_id, time_ns] = (offset, length)
        self.frame_sets: list[FrameSet] = [FrameSet(time_ns, frames[time_ns]) for time_ns in sorted(frames)]
        self._packs: dict[str, mmap.mmap] = {}

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
        return (camera_id, time_ns) in self._places

    def image(self, camera_id: str, time_ns: int) -> Image:
        """A camera's frame (H, W, 3) uint8, BGR, for the instant ``time_ns`` of a frame set.

        Raises:
            KeyError: the camera has no frame for that instant.
            InputError: the stored frame is damaged.
        """
        offset, length = self._places[camera_id, time_ns]
        data = np.frombuffer(self._pack(camera_id)[offset : offset + length], dtype=np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR_BGR) if len(data) == length else None
        if image is None:
            raise InputError(
                f"the stored frame of camera {camera_id} at {time_ns} ns is damaged", hint="Run the frames stage again."
            )
        return np.asarray(image, dtype=np.uint8)

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

    def _pack(self, camera_id: str) -> mmap.mmap:
        if camera_id not in self._packs:
            with (self.folder / _PACK.format(camera_id)).open("rb") as file:
                self._packs[camera_id] = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return self._packs[camera_id]
