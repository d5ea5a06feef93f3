"""ASAM OpenLABEL 1.0.0, with the names that the TUM Traffic data sets use (Zimmer et al. 2023, arXiv 2306.09266).

A file is a scene: coordinate systems (the world at the root, each camera below it by its pose), streams (each camera's
intrinsics), and frames with objects. 3D boxes are cuboids ``shape3D`` of ten numbers: centre x, y, z, quaternion
x, y, z, w, then length, width, height. 2D boxes are ``full_bbox``: centre, width, height, with the centre of the first
pixel at (0, 0), as the camera matrix has it. Written are one file a part, valid by the standard's JSON schema, where
TUM Traffic has a file a frame and one cuboid in the place of a list of them; both are read.

What the standard has no field for is in fields and attributes of our own, which it allows: ``time_ns`` of a frame and
of its streams, ``wibam_part`` of a file. An object that is not followed over time has a negative number.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.openlabel.reading import read_scenes
from wibam_core.exchange.openlabel.writing import write_scenes


class OpenLabel:
    """The format, for the registry."""

    name = "openlabel"
    title = "ASAM OpenLABEL"
    needs = frozenset({Part.CALIBRATION})
    writes = frozenset({Part.CALIBRATION, Part.BOXES_2D, Part.BOXES_3D, Part.TRACKS, Part.LABELS})
    reads = writes
    loses = (
        "Amodal 2D boxes, and standard deviations where some of a box's are unknown. Other programs pass over speeds, "
        "standard deviations and places of association."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """Write a file for each part that is there, or for the calibration alone."""
        require_parts(self, content)
        assert content.rig is not None
        return write_scenes(content, content.rig, folder)

    def read(self, path: Path) -> Content:
        """Read a scene, or all ``*.json`` of a folder, whose frames are put together.

        Cuboids of others become 3D boxes in the frame of the coordinate system at the root; a tilt is lost. One that
        names no coordinate system is in that of the sensor after which the frame's point cloud is named, as in TUM
        Traffic, or else at the root. Classes that are no road users of ours are left out, and noted.

        Raises:
            InputError: see `wibam_core.exchange.base.ReadableFormat.read`.
        """
        return read_scenes(path)
