"""All exchange formats: a line each."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from wibam_core.errors import NotFound
from wibam_core.exchange.base import ExchangeFormat, ReadableFormat
from wibam_core.exchange.coco import Coco
from wibam_core.exchange.everything import Everything
from wibam_core.exchange.geojson import GeoJson
from wibam_core.exchange.kitti import Kitti
from wibam_core.exchange.levelx import LevelX
from wibam_core.exchange.motchallenge import MotChallenge
from wibam_core.exchange.nuscenes import NuScenesResults
from wibam_core.exchange.openlabel import OpenLabel
from wibam_core.exchange.ottrk import Ottrk
from wibam_core.exchange.projected_csv import ProjectedCsv
from wibam_core.exchange.ssam import Ssam
from wibam_core.exchange.wibam.dataset import WibamDataset

_READABLE: tuple[ReadableFormat, ...] = (
    Coco(),
    Kitti(),
    LevelX(),
    MotChallenge(),
    NuScenesResults(),
    OpenLabel(),
    WibamDataset(),
)
_WRITTEN_ONLY: tuple[ExchangeFormat, ...] = (
    GeoJson(),
    Ottrk(),
    ProjectedCsv(),
    Ssam(),
)
_SINGLE = (*_READABLE, *_WRITTEN_ONLY)

_BY_NAME = {fmt.name: fmt for fmt in (*_SINGLE, Everything(_SINGLE))}
#: By name; the last writes all others.
FORMATS: Mapping[str, ExchangeFormat] = MappingProxyType(_BY_NAME)
#: Those of them that can be read.
READABLE: Mapping[str, ReadableFormat] = MappingProxyType({fmt.name: fmt for fmt in _READABLE})


def format_of(name: str) -> ExchangeFormat:
    """The format of a name.

    Raises:
        NotFound: there is none; the hint lists all.
    """
    if name not in FORMATS:
        raise NotFound(f"there is no exchange format {name!r}", hint=f"The formats are {', '.join(FORMATS)}.")
    return FORMATS[name]
