"""CSV in a projected coordinate reference system: one row a state, easting and northing in m.

The file's name has the system's EPSG code. ``yaw_rad`` and the velocities are in the axes of the grid:
counter-clockwise from the easting axis, along easting and northing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.csv_files import write_columns
from wibam_core.exchange.earth import Earth
from wibam_core.formats import tables
from wibam_core.formats.tracks import to_table
from wibam_core.geometry.box3d import BOX_FIELDS, XYZ, YAW, X, Y
from wibam_core.geometry.se3 import normalise_angle


class ProjectedCsv:
    """The format, for the registry."""

    name = "projected-csv"
    title = "CSV in UTM or another projected system"
    writes = frozenset({Part.TRACKS, Part.ORIGIN})
    needs = frozenset({Part.TRACKS, Part.ORIGIN})
    loses = (
        "Nothing of tracks, but standard deviations along easting and northing take errors along X and Y for "
        "independent. Distances between its coordinates are those of the map: in UTM up to 0.1 % off."
    )

    def write(self, content: Content, folder: Path) -> Sequence[Path]:
        """See `wibam_core.exchange.base.ExchangeFormat.write`."""
        require_parts(self, content)
        assert content.site is not None and content.site.origin is not None
        earth = Earth(content.site.origin)
        table = to_table(content.tracks or ())
        column = {name: table[name].to_numpy() for name in table.column_names}
        boxes, sd = tables.stack_columns(table, BOX_FIELDS), tables.stack_columns(table, tables.SD_FIELDS)
        places = earth.projected(boxes[:, XYZ])
        angle = earth.grid_angle_rad(boxes[:, XYZ])
        c, s = np.cos(angle), np.sin(angle)
        path = folder / f"tracks_epsg{earth.epsg}.csv"
        write_columns(
            path,
            {
                "time_ns": column["time_ns"],
                "track_id": column["track_id"],
                "class": column["class"],
                "easting_m": places[:, 0],
                "northing_m": places[:, 1],
                "z_m": column["z_m"],
                "length_m": column["length_m"],
                "width_m": column["width_m"],
                "height_m": column["height_m"],
                "yaw_rad": normalise_angle(boxes[:, YAW] + angle),
                "v_easting_mps": c * column["vx_mps"] - s * column["vy_mps"],
                "v_northing_mps": s * column["vx_mps"] + c * column["vy_mps"],
                "speed_mps": column["speed_mps"],
                "yaw_rate_radps": column["yaw_rate_radps"],
                "sd_easting_m": np.hypot(c * sd[:, X], s * sd[:, Y]),
                "sd_northing_m": np.hypot(s * sd[:, X], c * sd[:, Y]),
                **{name: sd[:, i] for i, name in enumerate(tables.SD_FIELDS) if i >= 2},
            },
        )
        return [path]
