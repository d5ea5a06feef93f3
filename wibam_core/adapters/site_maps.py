"""A picture of each site from above: decoded once, in a confined process, and kept as our own JPEG with its place."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wibam_core.adapters.database import Database
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.glimpses import GlimpseRequest, Glimpses
from wibam_core.adapters.models import SiteMapRow
from wibam_core.adapters.site_store import SiteStore
from wibam_core.documents.site_map import PlacedBy, Placing, SiteMap
from wibam_core.errors import InputError, NotFound
from wibam_core.exchange.earth import Earth
from wibam_core.formats.map_pictures import MOST_COORDINATE, Affine, shrunk
from wibam_core.jobs.records import Purpose, StoredFile
from wibam_core.site import Origin

#: A picture of a site lies within this of the site's origin, m: the world is flat.
_FARTHEST_M = 100_000.0


@dataclass(frozen=True)
class KeptMap:
    """A site's map.

    Attributes:
        map: where it lies, and whose picture it is.
        version: changes with the picture and with its place.
        note: why its placing is left out; empty where it is not.
    """

    map: SiteMap
    version: str
    note: str = ""

    def seen_from(self, origin: Origin | None) -> KeptMap:
        """For a world with this origin: without its placing, where that was found by another one."""
        by = self.map.origin
        if by is None or (origin is not None and _same_world(by, origin)):
            return self
        unplaced = self.map.model_copy(update={"placing": None, "placed_by": "nothing", "origin": None})
        note = (
            f"The map {self.map.filename} has no place here: it was laid on Earth by another origin. Place it by two "
            "points or its world file; uploaded again, it lies where the site's present origin says."
        )
        return replace(self, map=unplaced, note=note)


@dataclass(frozen=True)
class Given:
    """Where somebody says that a picture lies.

    Attributes:
        affine: (2, 3), pixel to world as `SiteMap.placing`; of a world file that of the picture as it was sent.
        placed_by: what tells it.
    """

    affine: Affine
    placed_by: PlacedBy


class SiteMaps:
    """One picture a site.

    Args:
        database: migrated.
        sites: whose uploads pictures come from.
        folder: where these lie.
        glimpses: decodes them.
        now: Unix seconds.
    """

    def __init__(
        self,
        database: Database,
        sites: SiteStore,
        folder: DataFolder,
        glimpses: Glimpses,
        now: Callable[[], float] = time.time,
    ) -> None:
        self._database, self._sites, self._folder, self._glimpses, self._now = database, sites, folder, glimpses, now

    def find(self, site_id: str) -> KeptMap | None:
        """The site's map; None where it has none."""
        with self._database.reading() as session:
            row = session.get(SiteMapRow, site_id)
            return None if row is None else _kept(row)

    def picture(self, site_id: str) -> bytes:
        """The picture, JPEG.

        Raises:
            NotFound: the site has no map.
        """
        with self._database.reading() as session:
            row = session.get(SiteMapRow, site_id)
            if row is None:
                raise _nothing(site_id)
            return row.picture

    def take(self, file: StoredFile, given: Given | None = None) -> KeptMap:
        """An uploaded picture takes the place of the one that was there; the upload is used up.

        A GeoTIFF is placed by itself: on Earth where the site has an origin, else the map's coordinates are the
        world's.

        Args:
            file: the upload.
            given: where the picture lies, whatever the file itself says.

        Raises:
            InputError: it was uploaded for something else, is no picture, its coordinates are degrees and the site
                has no origin, or they are no place on Earth; the picture that was there stays.
            TooLarge: it has too many pixels.
            ServiceUnavailable: too many other files are being looked at.
        """
        if file.purpose is not Purpose.MAP:
            raise InputError(f"the file was uploaded as {file.purpose}", hint="Upload it with the purpose 'map'.")
        answer, jpeg = self._glimpses.look(GlimpseRequest(look="map", path=self._folder.file(file)))
        size = int(answer["width_px"]), int(answer["height_px"])
        found = SiteMap(
            filename=file.filename,
            width_px=size[0],
            height_px=size[1],
            sent_width_px=answer["sent_px"][0],
            sent_height_px=answer["sent_px"][1],
            placing=None,
            placed_by="nothing",
        )
        if given is not None:
            found = _placed(found, given)
        elif answer["affine"] is not None:
            origin = self._sites.site(file.site_id).site.origin
            affine, used = _in_world(np.array(answer["affine"]), answer["epsg"], size, origin)
            change = {"placing": _rows(affine), "placed_by": "GeoTIFF", "origin": used}
            found = found.model_copy(update=change)
        kept = self._save(file.site_id, found, jpeg)
        with contextlib.suppress(NotFound):
            self._sites.retire_file(file.site_id, file.id)
        return kept

    def place(self, site_id: str, given: Given) -> KeptMap:
        """Say where the picture lies.

        Raises:
            NotFound: the site has no map.
        """
        with self._database.writing() as session:
            row = session.get(SiteMapRow, site_id)
            if row is None:
                raise _nothing(site_id)
            row.document = _placed(_kept(row).map, given).model_dump_json()
            row.saved_at = self._now()
            session.flush()
            return _kept(row)

    def remove(self, site_id: str) -> None:
        """Raises:
        NotFound: the site has no map.
        """
        with self._database.writing() as session:
            row = session.get(SiteMapRow, site_id)
            if row is None:
                raise _nothing(site_id)
            session.delete(row)

    def _save(self, site_id: str, found: SiteMap, jpeg: bytes) -> KeptMap:
        with self._database.writing() as session:
            row = session.get(SiteMapRow, site_id)
            if row is None:
                row = SiteMapRow(site_id=site_id)
                session.add(row)
            row.document, row.picture, row.saved_at = found.model_dump_json(), jpeg, self._now()
            session.flush()
            return _kept(row)


def _kept(row: SiteMapRow) -> KeptMap:
    return KeptMap(SiteMap.model_validate_json(row.document), f"{row.saved_at:.6f}")


def _same_world(first: Origin, second: Origin) -> bool:
    """Whether both lay a world on the same place; heights, and the system of exports, move no map."""
    where = ("latitude_deg", "longitude_deg", "x_axis_bearing_deg")
    return all(getattr(first, name) == getattr(second, name) for name in where)


def _nothing(site_id: str) -> NotFound:
    return NotFound(f"site {site_id} has no map", hint="Upload a picture with the purpose 'map', then PUT it here.")


def _rows(affine: Affine) -> Placing:
    (a, b, c), (d, e, f) = affine.tolist()
    return (a, b, c), (d, e, f)


def _placed(found: SiteMap, given: Given) -> SiteMap:
    affine = given.affine
    if given.placed_by == "world file":
        affine = shrunk(affine, found.sent_width_px / found.width_px, found.sent_height_px / found.height_px)
    return found.model_copy(update={"placing": _rows(affine), "placed_by": given.placed_by, "origin": None})


def _in_world(
    affine: Affine, epsg: int | None, size: tuple[int, int], origin: Origin | None
) -> tuple[Affine, Origin | None]:
    """(2, 3) of pixels to the world, from (2, 3) of pixels to a map's coordinates; and the origin, if that needs it.

    Raises:
        InputError: the map's coordinates are not in metres and there is no origin, or they are no place on Earth.
    """
    from pyproj import CRS, Transformer  # few requests need it
    from pyproj.exceptions import CRSError, ProjError

    try:
        system = None if epsg is None else CRS.from_epsg(epsg)
    except CRSError:
        system = None
    if system is not None and not (system.is_projected or system.is_geographic):
        raise InputError(
            f"the picture's coordinate system ({system.name}) says nothing of places on a map",
            hint="Save it in another coordinate system, such as UTM, or send a world file or two points with it.",
        )
    u, v = (np.array([0.0, n - 1.0]) for n in size)
    corners = np.array([[x, y, 1.0] for x in u for y in v])
    if system is None or origin is None:
        if system is not None and (system.is_geographic or system.axis_info[0].unit_name != "metre"):
            raise InputError(
                f"the picture's coordinates ({system.name}) are not in metres",
                hint="Say where the site's world lies on Earth (origin in its JSON), or project the picture to UTM.",
            )
        _check_place(affine, "" if system is None else f" of {system.name}")
        return affine, None
    try:
        to_earth = Transformer.from_crs(system, "EPSG:4326", always_xy=True)
        with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is checked
            lon, lat = to_earth.transform(*(affine @ corners.T)[:2])
            world = Earth(origin).world(np.asarray(lon), np.asarray(lat), np.full(len(corners), np.nan))[:, :2]
    except ProjError:
        world = np.full((len(corners), 2), np.nan)
    _check_place(world, f" of {system.name}")
    away_m = float(np.hypot(*world.T).min())
    if away_m > _FARTHEST_M:
        raise InputError(
            f"the picture's coordinates of {system.name} lie {away_m / 1000:,.0f} km from the site's origin",
            hint="Are its axes swapped, or the origin's latitude and longitude? Save it anew, in UTM say, or send a "
            "world file or two points with it.",
        )
    return np.linalg.lstsq(corners, world, rcond=None)[0].T, origin


def _check_place(numbers: NDArray[np.float64], system: str) -> None:
    """Raises:
    InputError: some are no number, or larger than the Earth.
    """
    if not (np.abs(numbers) <= MOST_COORDINATE).all():  # nor is what is no number
        raise InputError(
            f"the picture's coordinates{system} are no place on Earth",
            hint="Are its axes swapped, or is it in another coordinate system than it says? Save it anew, in UTM say, "
            "or send a world file or two points with it.",
        )
