"""Signal regions that are drawn in a way that hardly any head is seen, or that show none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from wibam_core.clocks import SignalChange
from wibam_core.documents.warnings import Caution
from wibam_core.site import SignalRegion, Site, SiteCamera

#: Heads are smaller than this share of a picture: larger regions are two corners rather than a corner and a size.
_LARGEST_SHARE = 0.04
#: Less of a region may lie beside the image without a word.
_BESIDE_SHARE = 0.1
#: Regions that share this much of what they cover are of one head.
_SAME_SHARE = 0.5


def region_cautions(site: Site) -> list[Caution]:
    """What is doubtful about the regions of a site as they are drawn and named."""
    found = []
    lit = [camera for camera in site.cameras if camera.signals]
    for camera in lit:
        found += [caution.of_camera(camera.id) for caution in _drawn(camera)]
        elsewhere = [signal.id for other in lit if other is not camera for signal in other.signals]
        found += [caution.of_camera(camera.id) for caution in _named(camera, elsewhere)]
    return found


def unseen_cautions(
    site: Site, changes: Mapping[str, Sequence[SignalChange]], confident: Mapping[str, Sequence[SignalChange]]
) -> list[Caution]:
    """Signals of which no light change was seen, or none clearly: they say nothing of a clock.

    Args:
        site: with the regions.
        changes: camera id -> all changes that were seen there.
        confident: those that are believed.
    """
    found = []
    for camera in site.cameras:
        seen = [change.signal_id for change in changes.get(camera.id, ())]
        believed = {change.signal_id for change in confident.get(camera.id, ())}
        for signal_id in dict.fromkeys(signal.id for signal in camera.signals):
            if camera.id not in changes or signal_id in believed:
                continue
            unclear = seen.count(signal_id)
            what = f"{unclear} light changes, none of them clear enough" if unclear else "no light change"
            caution = Caution(
                code="signal_unseen",
                message=f"where signal {signal_id} is marked there is {what}: it is not used",
                hint="Draw the region tightly around the lamps of one head, in pixels of the recording's size; "
                "`wibam signals` shows what is seen there.",
                details={"signal": signal_id, "changes": unclear},
            )
            found.append(caution.of_camera(camera.id))
    return found


def _drawn(camera: SiteCamera) -> Iterator[Caution]:
    image_px = camera.width_px * camera.height_px
    for signal in camera.signals:
        width, height = signal.region[2:]
        details = {"signal": signal.id, "region": list(signal.region)}
        if width * height > _LARGEST_SHARE * image_px:
            corners = " A region is x, y, width, height, not two corners." if _could_be_corners(camera, signal) else ""
            yield Caution(
                code="large_signal_region",
                message=f"the region of signal {signal.id} is {width:g}x{height:g} px, which is large for one head",
                hint=f"Draw it tightly around the lamps of one head: what passes behind is taken for lamps.{corners}",
                details=details,
            )
        beside = 1 - _overlap(signal.region, (0.0, 0.0, camera.width_px, camera.height_px)) / (width * height)
        if beside > _BESIDE_SHARE:
            yield Caution(
                code="signal_region_cut",
                message=f"{beside:.0%} of the region of signal {signal.id} lies beside the image of "
                f"{camera.width_px}x{camera.height_px} px",
                hint="Was it drawn in a picture of another size? It must hold all lamps of the head.",
                details=details,
            )
    for number, one in enumerate(camera.signals):
        for other in camera.signals[:number]:
            shared = _overlap(one.region, other.region)
            smaller = min(signal.region[2] * signal.region[3] for signal in (one, other))
            if one.id != other.id and shared > _SAME_SHARE * smaller:
                yield Caution(
                    code="signals_overlap",
                    message=f"signals {other.id} and {one.id} are marked at one place of the picture",
                    hint="Heads of other phases hang elsewhere: draw each around its own lamps.",
                    details={"signals": [other.id, one.id]},
                )


def _could_be_corners(camera: SiteCamera, signal: SignalRegion) -> bool:
    x, y, width, height = signal.region
    return x < width <= camera.width_px and y < height <= camera.height_px


def _named(camera: SiteCamera, elsewhere: Sequence[str]) -> Iterator[Caution]:
    for signal_id in dict.fromkeys(signal.id for signal in camera.signals):
        if signal_id in elsewhere:
            continue
        alike = next((other for other in elsewhere if other.strip().lower() == signal_id.strip().lower()), None)
        yield Caution(
            code="signal_alone",
            message=f"no other camera has a signal {signal_id!r}: it is not used"
            + (f", but one has {alike!r}" if alike is not None else ""),
            hint="Heads that show the same phase carry the same id in every camera, letter by letter.",
            details={"signal": signal_id},
        )


def _overlap(one: Sequence[float], other: Sequence[float]) -> float:
    """What two regions (x, y, width, height) share, px²."""
    across = min(one[0] + one[2], other[0] + other[2]) - max(one[0], other[0])
    down = min(one[1] + one[3], other[1] + other[3]) - max(one[1], other[1])
    return float(max(across, 0.0) * max(down, 0.0))
