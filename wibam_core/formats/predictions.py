"""3D boxes of every camera image, written and read instant by instant: memory stays flat however long the footage is.

A Parquet file with the columns of `wibam_core.formats.vehicles3d`, sorted by time, some instants a row group. Its
metadata names the images in which nothing was found.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from itertools import groupby
from pathlib import Path
from types import TracebackType

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import TypeAdapter, ValidationError

from wibam_core.errors import InputError
from wibam_core.formats import tables
from wibam_core.formats.vehicles3d import SCHEMA, table_of, vehicles_of
from wibam_core.scene import Vehicles3D

#: A row group has about so many boxes.
_GROUP_BOXES = 4096
_EMPTY_IMAGES = "wibam.empty_images"
_EMPTY = TypeAdapter(list[tuple[int, str]])


class PredictionsWriter:
    """Writes the file; only `close` finishes it.

    Args:
        path: of the file, which is not there yet.
    """

    def __init__(self, path: Path) -> None:
        self._writer = pq.ParquetWriter(path, SCHEMA, compression="zstd")
        self._waiting: list[Vehicles3D] = []
        self._empty: list[tuple[int, str]] = []

    def add(self, of_instant: Collection[Vehicles3D]) -> None:
        """What was found in the images of one instant, later than all before; one entry an image, empty ones, too."""
        self._waiting += [found for found in of_instant if len(found)]
        self._empty += [(found.time_ns, str(found.camera_id)) for found in of_instant if not len(found)]
        if sum(map(len, self._waiting)) >= _GROUP_BOXES:
            self._write_group()

    def close(self) -> None:
        """Write what is left."""
        if self._waiting:
            self._write_group()
        self._writer.add_key_value_metadata({_EMPTY_IMAGES: json.dumps(self._empty)})
        self._writer.close()

    def _write_group(self) -> None:
        self._writer.write_table(table_of(self._waiting))
        self._waiting = []

    def __enter__(self) -> PredictionsWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._writer.close()


class Predictions:
    """Reads the file.

    Args:
        path: of the file.

    Raises:
        InputError: it is not of this format.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file = pq.ParquetFile(path)
            said = (self._file.metadata.metadata or {}).get(_EMPTY_IMAGES.encode())
        except (OSError, pa.ArrowInvalid) as error:
            raise InputError(f"{path.name} cannot be read as Parquet: {error}", hint="Run the stage again.") from error
        self._name = path.name
        self._empty: dict[int, list[str]] = {}
        try:
            for time_ns, camera_id in _EMPTY.validate_json(said or b""):
                self._empty.setdefault(time_ns, []).append(camera_id)
        except ValidationError as error:
            raise InputError(
                f"{path.name} holds no predictions", hint="Run the stage again that makes them."
            ) from error

    def at(self, times_ns: Collection[int]) -> Iterator[tuple[int, dict[str, Vehicles3D]]]:
        """What was found at instants, ascending; an instant at which no image was searched does not come.

        Args:
            times_ns: which.

        Yields:
            The instant, and by camera id what was found in each image that was searched.
        """
        left = np.unique(np.array(sorted(times_ns), dtype=np.int64))
        for number in range(self._file.num_row_groups):
            first_ns, last_ns = self._span(number)
            earlier, within = left[left < first_ns], left[(left >= first_ns) & (left <= last_ns)]
            yield from self._without_boxes(earlier)
            left = left[left > last_ns]
            if len(within):
                yield from self._in_group(number, within)
        yield from self._without_boxes(left)

    def _span(self, group: int) -> tuple[int, int]:
        times = self._file.metadata.row_group(group).column(0).statistics
        return int(times.min), int(times.max)

    def _in_group(self, group: int, times_ns: np.ndarray) -> Iterator[tuple[int, dict[str, Vehicles3D]]]:
        table = tables.conform(self._file.read_row_group(group), SCHEMA, self._name, "predictions")
        by_time = {
            time_ns: {str(found.camera_id): found for found in of_instant}
            for time_ns, of_instant in groupby(vehicles_of(table), key=lambda found: found.time_ns)
        }
        for time_ns in times_ns.tolist():
            found = by_time.get(time_ns, {}) | self._nothing(time_ns)
            if found:
                yield time_ns, found

    def _without_boxes(self, times_ns: np.ndarray) -> Iterator[tuple[int, dict[str, Vehicles3D]]]:
        for time_ns in times_ns.tolist():
            if found := self._nothing(time_ns):
                yield time_ns, found

    def _nothing(self, time_ns: int) -> dict[str, Vehicles3D]:
        """The images of an instant that show nobody."""
        cameras = self._empty.get(time_ns, ())
        return {camera: Vehicles3D.of(time_ns, np.empty((0, 7)), camera_id=camera) for camera in cameras}
