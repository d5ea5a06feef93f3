"""The published WIBAM data set, out and in; `wibam_core.exchange.wibam.layout` says what lies where.

One intersection, four cameras, 12.5 frames a second: Howe, Reid and Mackenzie 2021 (arXiv 2110.10966), Zenodo record
5609988.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.wibam import reading, writing


class WibamDataset:
    """See this module."""

    name = "wibam-dataset"
    title = "WIBAM data set"
    needs = frozenset({Part.CALIBRATION, Part.BOXES_2D})
    writes = frozenset({Part.CALIBRATION, Part.BOXES_2D, Part.LABELS, Part.FRAMES})
    reads = frozenset({Part.CALIBRATION, Part.BOXES_2D, Part.LABELS, Part.FRAMES})
    loses = (
        "Names of cameras, which become numbers; times within 80 ms; what a vehicle is over time; 3D boxes and tracks; "
        "amodal boxes; places and classes of vehicles, which are found again from their boxes; and what tells classes "
        "apart that nuScenes has under one name."
    )

    def write(self, content: Content, folder: Path) -> Iterable[Path]:
        """Write the folder ``wibam``; its frames where the content has them.

        Raises:
            InputError: calibration or 2D boxes are missing, or instants follow each other faster than 12.5 a second.
        """
        require_parts(self, content)
        return writing.write(content, folder / "wibam")

    def read(self, path: Path) -> Content:
        """Read the folder ``wibam``, or the one that holds it.

        All cameras' frames of an instant count as taken at once. How hand labels are meant is decided by which reading
        of them reprojects best onto the 2D boxes, see `wibam_core.exchange.wibam.hand_labels`, and noted.

        Raises:
            InputError: naming the file and the field.
        """
        return reading.read(path / "wibam" if (path / "wibam").is_dir() else path)
