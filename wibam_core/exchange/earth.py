"""From a site's world to Earth, and back: geographic and projected coordinates."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from wibam_core.errors import InputError
from wibam_core.scene import FloatArray
from wibam_core.site import Origin

if TYPE_CHECKING:  # takes long to import, and few commands and requests need it
    from pyproj import Transformer

_WGS84_3D = 4979


class Earth:
    """Where a world lies.

    The ground plane is tangent to the WGS 84 ellipsoid at the origin (a topocentric frame, EPSG method 9837); 200 m
    away the ellipsoid lies 3 mm below it.
    """

    def __init__(self, origin: Origin) -> None:
        self._origin = origin
        bearing = np.radians(origin.x_axis_bearing_deg)
        #: (2, 2): east and north of the world's X and Y axes.
        self._axes = np.array([[np.sin(bearing), -np.cos(bearing)], [np.cos(bearing), np.sin(bearing)]])

    @cached_property
    def epsg(self) -> int:
        """Code of the projected system: the origin's, or that of the WGS 84 UTM zone where it lies.

        Raises:
            InputError: none is named, and the origin lies so near to a pole that there is no zone.
        """
        from pyproj.aoi import AreaOfInterest
        from pyproj.database import query_utm_crs_info

        if self._origin.epsg is not None:
            return self._origin.epsg
        lon, lat = self._origin.longitude_deg, self._origin.latitude_deg
        zones = query_utm_crs_info("WGS 84", AreaOfInterest(lon, lat, lon, lat), contains=True)
        if not zones:
            raise InputError(
                f"there is no UTM zone at latitude {lat:g}", hint="Name a projected system as origin.epsg in site.json."
            )
        return int(zones[0].code)

    def bearing_deg(self, yaw_rad: FloatArray) -> FloatArray:
        """Bearings (N,) in [0, 360), clockwise from true north, of headings (N,)."""
        return (self._origin.x_axis_bearing_deg - np.degrees(yaw_rad)) % 360.0

    def geographic(self, points_m: FloatArray) -> FloatArray:
        """Longitude and latitude (deg), and the altitude (m) where it is known, of world points (N, 3).

        Returns:
            (N, 3), or (N, 2) without an altitude, in the order of GeoJSON (RFC 7946, section 3.1.1).
        """
        positions = self._geographic(points_m)
        return positions if self._origin.altitude_m is not None else positions[:, :2]

    def world(self, longitude_deg: FloatArray, latitude_deg: FloatArray, altitude_m: FloatArray) -> FloatArray:
        """World points (N, 3) of places on Earth (N,), WGS 84; an altitude that is NaN is that of the origin."""
        level = np.where(np.isnan(altitude_m), self._origin.altitude_m or 0.0, altitude_m)
        east, north, up = self._from_topocentric.transform(longitude_deg, latitude_deg, level, direction="INVERSE")
        return np.column_stack([np.column_stack([east, north]) @ self._axes, up])

    def projected(self, points_m: FloatArray) -> FloatArray:
        """Easting and northing (N, 2) in m of world points (N, 3)."""
        position = self._geographic(points_m)
        return np.stack(self._to_projected.transform(position[:, 0], position[:, 1], position[:, 2])[:2], axis=1)

    def grid_angle_rad(self, points_m: FloatArray) -> FloatArray:
        """Direction (N,) of the world's X axis at points (N, 3), counter-clockwise from the easting axis.

        It varies with the place, since meridians converge.
        """
        step = self.projected(points_m + np.array([1.0, 0.0, 0.0])) - self.projected(points_m)
        return np.arctan2(step[:, 1], step[:, 0])

    def _geographic(self, points_m: FloatArray) -> FloatArray:
        points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
        east_north = points[:, :2] @ self._axes.T
        return np.stack(self._from_topocentric.transform(east_north[:, 0], east_north[:, 1], points[:, 2]), axis=1)

    @cached_property
    def _from_topocentric(self) -> Transformer:
        from pyproj import Transformer

        lon, lat, height = self._origin.longitude_deg, self._origin.latitude_deg, self._origin.altitude_m or 0.0
        return Transformer.from_pipeline(
            f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 +lon_0={lon!r} +lat_0={lat!r} +h_0={height!r} "
            "+step +inv +proj=cart +ellps=WGS84"
        )

    @cached_property
    def _to_projected(self) -> Transformer:
        from pyproj import Transformer
        from pyproj.network import set_network_enabled  # type: ignore[attr-defined]  # its stub does not list it

        set_network_enabled(active=False)  # an environment variable could have PROJ fetch grids
        return Transformer.from_crs(_WGS84_3D, self.epsg, always_xy=True)
