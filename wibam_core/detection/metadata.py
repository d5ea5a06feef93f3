"""What an ONNX network says of itself."""

from __future__ import annotations

import json

import onnxruntime

from wibam_core.errors import InvalidWeights
from wibam_core.road_users import CLASSES, RoadUserClass


def network_classes(session: onnxruntime.InferenceSession, name: str) -> tuple[RoadUserClass, ...]:
    """Our class of each of a network's, by the names that its metadata give as JSON under ``classes``.

    Args:
        session: the network.
        name: what an error calls it.

    Raises:
        InvalidWeights: it names none, or one that we do not know.
    """
    named = session.get_modelmeta().custom_metadata_map.get("classes", "")
    try:
        names = [str(one) for one in json.loads(named)]
    except (ValueError, TypeError) as error:
        raise InvalidWeights(
            f"{name} does not say which classes it knows", hint="Use the file as it was exported, metadata included."
        ) from error
    known = {str(c): c for c in CLASSES}
    unknown = sorted(set(names) - set(known))
    if unknown:
        raise InvalidWeights(
            f"{name} knows a class {unknown[0]!r}, which we do not",
            hint=f"The classes are {', '.join(known)}: use the version of this software that the file was made with.",
        )
    return tuple(known[one] for one in names)
