"""Look into one uploaded file: ``python -m wibam_core.adapters.glimpse REQUEST``, a JSON `GlimpseRequest`.

An uploaded file is not to be trusted, so that a process of its own opens it, confined and for a few seconds. On
standard output come a line of JSON, ``{"header": ...}`` or ``{"error": ...}`` (`WibamError.to_dict`), and then a file:
a JPEG where a frame or a map was asked for, ONNX where a network, PDF where a table.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from wibam_core.adapters.glimpses import ComparisonInputs, ForeignCalibration, GlimpseRequest, ReviewedConflicts
from wibam_core.errors import InputError, WibamError
from wibam_core.formats.model_card import read_card
from wibam_core.video.seeking import frames_from, read_header

Image = NDArray[np.uint8]
#: A browser shows it, and 100 m are drawn at 2.5 cm a pixel.
_LONGEST_MAP_PX = 4096


def main(request: GlimpseRequest) -> tuple[dict[str, object], bytes]:
    """The answer's header, and the JPEG file or nothing.

    Raises:
        WibamError: the recording cannot be read, has nothing at that time, or does not contain a region.
    """
    if request.look == "network":
        return _network(request)
    if request.look == "map":
        return _map(request)
    if request.look == "calibration":
        return _calibration(ForeignCalibration.model_validate_json(sys.stdin.buffer.read())), b""
    if request.look == "conflicts":
        return _conflicts(ReviewedConflicts.model_validate_json(sys.stdin.buffer.read()))
    if request.comparison is not None:
        return _comparison(request.comparison), b""
    if request.look == "header":
        header = read_header(request.file)
        return dict(vars(header)), b""
    if request.look == "frame":
        for time_ns, image in frames_from(request.file, request.start_ns, width_px=request.width_px):
            return {"time_ns": time_ns}, _jpeg(image)
        raise InputError("the recording has no frame at that time", hint="Ask for an earlier time.")
    return _signals(request), b""


def _network(request: GlimpseRequest) -> tuple[dict[str, object], bytes]:
    """The card of a network, and its ONNX file, if its family has any."""
    read_card(request.file)  # most of what is no network is told by its header
    from wibam_core.networks.registry import load_network  # torch takes seconds to import

    network = load_network(request.file)
    return {"card": network.card.model_dump(mode="json")}, network.onnx() or b""


def _calibration(given: ForeignCalibration) -> dict[str, object]:
    """A camera as files of other programs describe it."""
    from wibam_core.calibration.foreign.registry import read_named
    from wibam_core.calibration.foreign.to_site import chosen, describe

    found, formats = [], []
    for file in given.files:
        form, cameras = read_named(file.name, file.text)
        found.append(chosen(cameras, [given.camera.id, *given.names], file.name))
        formats.append(form)
    size_px = given.camera.width_px, given.camera.height_px
    described = describe(given.camera.id, found, size_px, given.camera, given.origin)
    return {
        "camera": described.camera.model_dump(mode="json"),
        "origin": None if described.origin is None else described.origin.model_dump(mode="json"),
        "formats": formats,
        "notes": list(described.notes),
    }


def _comparison(inputs: ComparisonInputs) -> dict[str, object]:
    """Of two networks on the instants that neither learned from."""
    from wibam_core.artifacts import catalogue  # these take longer to import than a frame takes to decode
    from wibam_core.artifacts.access import ArtifactReader
    from wibam_core.evaluation.comparison import compare_networks, held_out_from_both
    from wibam_core.evaluation.labels_at import LabelTimeline
    from wibam_core.evaluation.labels_of_views import labels_of_views
    from wibam_core.formats.labels import read_labels
    from wibam_core.formats.tables import class_named

    first, second = ArtifactReader(inputs.first), ArtifactReader(inputs.second)
    rig = second.read(catalogue.RIG)
    instants = held_out_from_both(
        first.read(catalogue.FRAMES).frame_sets,
        second.read(catalogue.FRAMES).frame_sets,
        first.read(catalogue.SPLIT).times_ns["test"],
        second.read(catalogue.SPLIT).times_ns["test"],
    )
    labels = None if inputs.labels is None else LabelTimeline(labels_of_views(read_labels(inputs.labels), rig))
    compared = compare_networks(
        first.read(catalogue.PREDICTIONS_FINETUNED),
        second.read(catalogue.PREDICTIONS_FINETUNED),
        instants,
        second.read(catalogue.ANNOTATIONS),
        rig,
        inputs.config,
        labels,
        {class_named(name) for name in inputs.known},
        inputs.cautions,
    )
    return compared.model_dump(mode="json")


def _conflicts(given: ReviewedConflicts) -> tuple[dict[str, object], bytes]:
    """A table as PDF."""
    from wibam_core.report.conflict_table import conflict_table  # matplotlib takes a second to import

    return {}, conflict_table(given.heading, given.about, given.conflicts, given.reviews)


def _map(request: GlimpseRequest) -> tuple[dict[str, object], bytes]:
    """A picture from above, and where its file says that it lies."""
    from wibam_core.formats.map_pictures import read_map_picture

    found = read_map_picture(request.file, _LONGEST_MAP_PX)
    height, width = found.image.shape[:2]
    affine = None if found.affine is None else found.affine.tolist()
    header = {"width_px": width, "height_px": height, "affine": affine, "epsg": found.epsg, "sent_px": found.sent_px}
    return header, _jpeg(np.ascontiguousarray(found.image[..., ::-1]))


def _signals(request: GlimpseRequest) -> dict[str, object]:
    from wibam_core.config import SyncConfig  # these take longer to import than a frame takes to decode
    from wibam_core.sync.changes import detect_changes
    from wibam_core.sync.document import seen_change

    times: list[int] = []
    seen = detect_changes(_stretch(request, times), "", request.regions, SyncConfig().min_lit_share)
    changes = [seen_change(change).model_dump(mode="json") for change in seen]
    ends = {"from_s": times[0] / 1e9, "to_s": times[-1] / 1e9} if times else {"from_s": 0.0, "to_s": 0.0}
    return {"changes": changes, **ends}


def _stretch(request: GlimpseRequest, times: list[int]) -> Iterator[tuple[int, Image]]:
    """The frames of the stretch; their times are noted."""
    for time_ns, image in frames_from(request.file, request.start_ns):
        if time_ns > request.start_ns + request.duration_ns:
            return
        times.append(time_ns)
        yield time_ns, image


def _jpeg(image: Image) -> bytes:
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 88])
    assert done, "a frame of three colours can be written"
    return data.tobytes()


if __name__ == "__main__":
    try:
        answer, jpeg = main(GlimpseRequest.model_validate_json(sys.argv[1]))
        line: dict[str, object] = {"header": answer}
    except WibamError as error:
        line, jpeg = {"error": error.to_dict()}, b""
    sys.stdout.buffer.write(json.dumps(line).encode() + b"\n" + jpeg)
