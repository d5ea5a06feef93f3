"""Our classes by the names of another vocabulary of the catalogue of road users."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from wibam_core.road_users import CLASSES, RoadUserClass
from wibam_core.traits import ForeignName, NamesElsewhere

#: One vocabulary of the catalogue, e.g. ``lambda names: names.kitti``.
Vocabulary = Callable[[NamesElsewhere], ForeignName]


def classes_by_name(vocabulary: Vocabulary) -> Mapping[str, RoadUserClass]:
    """Every name there that means a class of ours."""
    return MappingProxyType({name: c for c in CLASSES for name in vocabulary(c.traits.elsewhere).read})
