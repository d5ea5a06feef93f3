"""Recordings and signal regions to a clock map per camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import pairwise

from wibam_core.artifacts.catalogue import CHANGES, CLOCKS, PROBE
from wibam_core.clocks import ClockMap, SignalChange
from wibam_core.config import SyncConfig
from wibam_core.documents.recordings import VideoInfo
from wibam_core.documents.synchronisation import Synchronisation
from wibam_core.errors import MissingCamera, NoSignalChange, UnknownClock
from wibam_core.formats.clocks import Clocks
from wibam_core.progress import part
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.listening import listen
from wibam_core.stages.passing import Passing
from wibam_core.sync.changes import SignalWatch
from wibam_core.sync.document import LEAST_SHARE, ambiguities, doubts, sync_document
from wibam_core.sync.hearing import SoundAlignment
from wibam_core.sync.paths import GroundPath
from wibam_core.sync.regions import region_cautions, unseen_cautions
from wibam_core.sync.segments import InSegments, Span
from wibam_core.sync.set_clocks import least_share, set_cautions, synchronise_set_clocks
from wibam_core.sync.sound_pairs import sound_cautions

#: What places a segment no better than to a second.
_UNSURE = ("assumed", "creation_time", "name")


def run(context: StageContext, config: SyncConfig) -> Summary:
    """Write `CLOCKS` and `CHANGES`.

    Raises:
        NoSignalChange: the traffic is not asked, and a camera has no signal region, sees no change or none in common
            with others, or its changes mostly meet none under any offset.
        UnknownClock: neither lights nor traffic connect a camera with the others.
        MissingCamera: if a camera has no recording.
    """
    if config.method == "none":
        reference = context.site.camera_ids[0]
        context.write(CLOCKS, Clocks({camera_id: ClockMap() for camera_id in context.site.camera_ids}))
        context.write(CHANGES, Synchronisation(method="none", reference=reference, changes={}, groups=[], cameras={}))
        return {"method": "none"}

    for camera_id in context.site.camera_ids:
        if camera_id not in context.recordings:
            raise MissingCamera(f"there is no recording for camera {camera_id}", camera=camera_id)
    infos = {camera_id: context.read(PROBE).cameras[camera_id] for camera_id in context.site.camera_ids}
    sounds = listen(context, _segments_s(infos)) if config.sound else []
    passing, watches = Passing(context, infos), _watches(context, config, infos)
    if config.method == "signals":
        passing.lights(watches, context.progress)
        changes = _changes(watches, config)
        found = _by_lights(context, config, infos, changes, sounds)
        assert found is not None, "lights that are asked alone answer or raise"
    else:
        found, changes = _with_traffic(context, config, infos, passing, watches, sounds)
    context.progress(1.0)
    by_camera = found.found
    result = by_camera.result
    document = sync_document(
        changes,
        result,
        by_camera.traffic,
        by_camera.disagreeing,
        found.placed,
        found.assumed,
        sounds,
        by_camera.by_sound,
    )
    cautions = [*ambiguities(document), *doubts(document, config.max_offset_s), *sound_cautions(document)]
    cautions += set_cautions(found, _segments_s(infos))
    if watches:
        cautions += [
            *region_cautions(context.site),
            *unseen_cautions(context.site, changes, _confident(changes, config)),
        ]
    context.write(CLOCKS, Clocks(result.clocks, result.errors))
    context.write(CHANGES, document)
    context.warn(*cautions)
    cameras = {camera_id: clock.model_dump() for camera_id, clock in document.cameras.items()}
    return {"method": document.method, "matched_changes": len(result.groups), "cameras": cameras}


def _by_lights(
    context: StageContext,
    config: SyncConfig,
    infos: Mapping[str, VideoInfo],
    changes: Mapping[str, Sequence[SignalChange]],
    sounds: Sequence[SoundAlignment] = (),
) -> InSegments | None:
    """The lights' answer, with the sound where it is given; None where they have none, and the traffic may be asked."""
    reference = context.site.camera_ids[0]
    confident = _confident(changes, config)
    alone = config.method == "signals"
    if not alone and any(not confident.get(camera_id) for camera_id in infos):
        return None
    try:
        return _in_segments(infos, reference, config, confident, None, sounds)
    except NoSignalChange:
        if alone:
            raise
        return None


def _with_traffic(
    context: StageContext,
    config: SyncConfig,
    infos: Mapping[str, VideoInfo],
    passing: Passing,
    watches: Mapping[str, SignalWatch],
    sounds: Sequence[SoundAlignment],
) -> tuple[InSegments, dict[str, list[SignalChange]]]:
    """What the lights say, and traffic and sound where asked for or they leave anything open; and all light changes.

    Each recording is decoded once, for both: whether the lights are enough is known at the end. Where they may be,
    every other frame of the traffic is looked at on the way, which is enough to decide between offsets that sound
    lights leave open. The others are looked at in a second pass if that does not decide.
    """
    may_do = config.method == "auto" and set(watches) == set(infos)
    rate_hz = config.traffic_rate_hz / (2 if may_do else 1)
    paths = passing.paths(rate_hz, part(context.progress, 0.0, 0.65 if may_do else 1.0), watches)
    changes = _changes(watches, config)

    def together(paths: Mapping[str, Sequence[GroundPath]]) -> InSegments:
        reference = context.site.camera_ids[0]
        return _in_segments(infos, reference, config, _confident(changes, config), paths, sounds)

    if not may_do:
        return together(paths), changes
    lights = _by_lights(context, config, infos, changes)
    if lights is not None and _is_sure(lights):
        return lights, changes
    if lights is not None and lights.found.is_ambiguous and _is_sound(lights):
        with suppress(NoSignalChange, UnknownClock):
            found = together(paths)
            if _is_sure(found) and not found.found.disagreeing:
                return found, changes
    return together(passing.paths(config.traffic_rate_hz, part(context.progress, 0.65, 1.0))), changes


def _in_segments(
    infos: Mapping[str, VideoInfo],
    reference: str,
    config: SyncConfig,
    changes: Mapping[str, Sequence[SignalChange]],
    paths: Mapping[str, Sequence[GroundPath]] | None,
    sounds: Sequence[SoundAlignment],
) -> InSegments:
    return synchronise_set_clocks(
        _segments_s(infos),
        _segments_s(infos, (*_UNSURE, "stamps")),
        reference,
        changes=changes,
        paths=paths,
        sounds=sounds,
        max_offset_s=config.max_offset_s,
    )


def _is_sure(found: InSegments) -> bool:
    return _is_sound(found) and not found.found.is_ambiguous


def _is_sound(found: InSegments) -> bool:
    """Whether most changes that could meet do, and no segment lies where it was only assumed to."""
    return least_share(found) >= LEAST_SHARE and not any(found.assumed.values())


def _confident(changes: Mapping[str, Sequence[SignalChange]], config: SyncConfig) -> dict[str, list[SignalChange]]:
    return {
        camera_id: [c for c in seen if c.confidence >= config.min_confidence] for camera_id, seen in changes.items()
    }


def _segments_s(infos: Mapping[str, VideoInfo], unsure: Sequence[str] = _UNSURE) -> dict[str, list[Span]]:
    """Camera id -> stretches of its recording; all but the first begin with a segment that is placed by one of
    ``unsure``, which does not tell the time that passed to a frame."""
    found: dict[str, list[Span]] = {}
    for camera_id, info in infos.items():
        begins = [info.first_ns, *(one.first_ns for one in info.segments[1:] if one.placed_by in unsure)]
        ends = [*(one.last_ns for one, then in pairwise(info.segments) if then.placed_by in unsure), info.last_ns]
        found[camera_id] = [(begin / 1e9, end / 1e9) for begin, end in zip(begins, ends, strict=True)]
    return found


def _watches(context: StageContext, config: SyncConfig, infos: Mapping[str, VideoInfo]) -> dict[str, SignalWatch]:
    """What watches the signals of each camera that has any; all must have where the lights are asked alone."""
    for camera in context.site.cameras:
        if config.method == "signals" and not camera.signals:
            raise NoSignalChange(
                f"camera {camera.id} has no signal region",
                hint="Draw a region around a signal head in this camera, or set sync.method to 'auto' or 'traffic'.",
                camera=camera.id,
            )
    return {
        camera.id: SignalWatch(camera.id, camera.signals, infos[camera.id].width_px, infos[camera.id].height_px)
        for camera in context.site.cameras
        if camera.signals and config.method != "traffic"
    }


def _changes(watches: Mapping[str, SignalWatch], config: SyncConfig) -> dict[str, list[SignalChange]]:
    return {camera_id: watch.changes(config.min_lit_share) for camera_id, watch in watches.items()}
