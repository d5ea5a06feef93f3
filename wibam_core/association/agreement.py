"""Whether a camera sees road users where the others do: the check that needs neither points nor a signal.

A world that is turned or shifted, the recording of another camera, or a clock that is wrong by seconds fit everything
that one camera says of itself. But then its boxes lie on those of other cameras no more often than by chance, which is
told by pairing moments that have nothing to do with each other. What stands still meets at any two moments alike, and
says nothing: only road users that move are counted. Two cameras whose recordings were exchanged are found by looking
through each one's calibration at what the other one saw.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy.spatial import cKDTree

from wibam_core.association.rays import ground_points, within_range
from wibam_core.documents.warnings import Caution
from wibam_core.road_users import CLASSES
from wibam_core.scene import AnnotatedInstant, CameraRig, Detections2D, FloatArray

#: So many instants are looked at, spread over the recording; each is compared with some that are this many away, too.
_MOST_INSTANTS = 150
_APART = (0.31, 0.47, 0.61)
#: Boxes of one road user in two cameras lie so near to each other, for cameras that see it within this range, m.
_NEAR_M, _RANGE_M = 3.0, 50.0
#: A road user stands where its camera shows one in this share, or more, of the moments that are so far away.
_STANDING = 0.15
#: Fewer road users that move than this in a field of view that two cameras share say nothing.
_FEWEST = 60
#: Beyond chance, of the road users that another camera could show: fewer than this are none, and so many are certain.
_NONE, _CERTAIN = 0.05, 0.15
#: Where so many meet, by chance or not, cameras agree: queues form at the same places.
_AGREED = 0.5
#: A camera agrees with none where it does by less than this share of what the best two do.
_SHARE_OF_USUAL = 0.25
#: Exchanged cameras agree this many times better than before.
_BETTER = 4.0


@dataclass(frozen=True)
class Agreement:
    """How often one camera's road users that move are where others see one.

    Attributes:
        could: those that another camera could show.
        met: of these, those that have one of its boxes near them.
        by_chance: the same where the other camera's boxes are those of other moments.
    """

    could: float
    met: float
    by_chance: float

    @property
    def beyond_chance(self) -> float:
        """Share of road users that meet because they are the same."""
        return (self.met - self.by_chance) / max(self.could, 1.0)


Pairs = Mapping[tuple[str, str], Agreement]


def agreement_cautions(instants: Sequence[AnnotatedInstant], rig: CameraRig) -> list[Caution]:
    """Cameras that see hardly a road user where others see one.

    Args:
        instants: in order of time, with detections.
        rig: the calibrated cameras.
    """
    step = max(len(instants) // _MOST_INSTANTS, 1)
    looked = _Looked(instants[::step], rig)
    pairs = {pair: looked.agreement(*pair) for pair in permutations(rig.mounted, 2)}
    found = {camera_id: best for camera_id in rig.mounted if (best := _best(camera_id, pairs)) is not None}
    usual = max((agreement.beyond_chance for agreement in found.values()), default=0.0)
    doubtful = [camera_id for camera_id, agreement in found.items() if _is_none(agreement, usual)]
    exchanged = {camera_id: _exchanged_with(camera_id, looked, found[camera_id]) for camera_id in doubtful}
    return [_caution(camera_id, found[camera_id], exchanged[camera_id]).of_camera(camera_id) for camera_id in doubtful]


def _best(camera_id: str, pairs: Pairs) -> Agreement | None:
    """With the camera that it agrees with best; None where it shares too few road users with any."""
    own = [one for pair, one in pairs.items() if camera_id in pair and one.could >= _FEWEST]
    return max(own, key=lambda one: one.beyond_chance, default=None)


def _is_none(best: Agreement, usual: float) -> bool:
    """Whether road users meet by chance alone, or hardly ever where those of other cameras do."""
    if best.met >= _AGREED * best.could:
        return False
    noise = 2.0 * np.sqrt(max(best.by_chance, 1.0)) / best.could
    return best.beyond_chance < max(_NONE + noise, _SHARE_OF_USUAL * usual)


def _exchanged_with(camera_id: str, looked: _Looked, before: Agreement) -> str | None:
    """The camera that its recording looks to be of."""
    found: dict[str, float] = {}
    for other in looked.alike(camera_id):
        swap = {camera_id: other, other: camera_id}
        pairs = {
            pair: looked.agreement(*pair, swap)
            for pair in permutations(looked.rig.mounted, 2)
            if camera_id in pair or other in pair
        }
        after = [best.beyond_chance for own in swap if (best := _best(own, pairs)) is not None]
        if len(after) == len(swap) and min(after) >= max(_CERTAIN, _BETTER * before.beyond_chance):
            found[other] = min(after)
    return max(found, key=lambda other: found[other], default=None)


def _caution(camera_id: str, agreement: Agreement, other: str | None) -> Caution:
    share = agreement.beyond_chance
    message = (
        f"of {agreement.could:.0f} sightings of moving road users where another camera looks, too, "
        f"{max(share, 0.0):.0%} are where that one sees one, chance aside"
    )
    hint = (
        "Its calibration is of another world (turned, shifted, another origin), its clock is wrong, or its recording "
        "is another camera's: compare one moving vehicle in two cameras."
    )
    if other is not None:
        hint = (
            f"The recordings, or the calibrations, of {camera_id} and {other} look exchanged: then their road users "
            "meet. Exchange them."
        )
    details = {"could": agreement.could, "met": agreement.met, "by_chance": agreement.by_chance, "exchanged": other}
    return Caution(code="camera_disagrees", message=message, hint=hint, details=details)


class _Looked:
    """Places on the road of what each camera saw, through its own calibration or another one's.

    Args:
        instants: with detections.
        rig: the cameras.
    """

    def __init__(self, instants: Sequence[AnnotatedInstant], rig: CameraRig) -> None:
        self.rig, self._instants = rig, instants
        self._placed: dict[tuple[str, str], list[FloatArray]] = {}
        self._moving: dict[tuple[str, str], list[FloatArray]] = {}

    def alike(self, camera_id: str) -> Iterator[str]:
        """Other cameras with pictures of the same size; of wide lenses there are none, whose views differ."""
        for other in self.rig.mounted:
            both = [self.rig.get(c) for c in (camera_id, other)]
            if other != camera_id and None not in both and len({c.size_px for c in both if c is not None}) == 1:
                yield other

    def agreement(self, one: str, other: str, swap: Mapping[str, str] | None = None) -> Agreement:
        """Of road users that ``one`` sees moving, with boxes of ``other``, each seen in the recording of ``swap``."""
        found = [
            self._met(self._moving_places(own_view, swap), self._places(other_view, swap), other_view)
            for own_view in self._views(one)
            for other_view in self._views(other)
        ]
        could, met, by_chance = np.sum([(own.could, own.met, own.by_chance) for own in found], axis=0).tolist()
        return Agreement(could, met, by_chance)

    def _views(self, camera_id: str) -> list[str]:
        return [view_id for view_id in self.rig if self.rig.mounted_id(view_id) == camera_id]

    def _places(self, view_id: str, swap: Mapping[str, str] | None) -> list[FloatArray]:
        source = (swap or {}).get(view_id, view_id)
        if (view_id, source) not in self._placed:
            seen = [instant.detections.get(source) for instant in self._instants]
            self._placed[view_id, source] = [self._on_road(view_id, one) for one in seen]
        return self._placed[view_id, source]

    def _moving_places(self, view_id: str, swap: Mapping[str, str] | None) -> list[FloatArray]:
        key = view_id, (swap or {}).get(view_id, view_id)
        if key not in self._moving:
            self._moving[key] = _without_standing(self._places(view_id, swap))
        return self._moving[key]

    def _on_road(self, view_id: str, seen: Detections2D | None) -> FloatArray:
        if seen is None or not len(seen):
            return np.empty((0, 2))
        camera = self.rig[view_id]
        kept = np.array([not CLASSES[number].traits.vulnerable for number in seen.classes])
        points = ground_points(camera, seen.whole_boxes[kept], seen.classes[kept])
        return points[within_range(points, camera.centre_m[:2], _RANGE_M)]

    def _met(self, own: list[FloatArray], theirs: list[FloatArray], other_view: str) -> Agreement:
        camera, count = self.rig[other_view], len(own)
        could, met, by_chance = 0, 0, 0.0
        for number, points in enumerate(own):
            pixels, _ = camera.project(np.column_stack([points, np.zeros(len(points))]))
            shown = points[camera.contains(pixels) & within_range(points, camera.centre_m[:2], _RANGE_M)]
            could += len(shown)
            met += _near(shown, theirs[number])
            others = [theirs[(number + round(share * count)) % count] for share in _APART]
            by_chance += float(np.mean([_near(shown, other) for other in others]))
        return Agreement(could, met, by_chance)


def _without_standing(places: Sequence[FloatArray]) -> list[FloatArray]:
    """Of the places (N, 2) at each moment, those where the camera hardly ever shows a road user at other moments."""
    if not places:
        return []
    count = len(places)
    ahead = np.arange(count)
    away = (ahead >= min(_APART) * count) & (ahead <= (1 - min(_APART)) * count)
    points, moments = np.concatenate(places), np.repeat(ahead, [len(one) for one in places])
    stands = np.zeros(len(points), dtype=bool)
    for number, near in enumerate(cKDTree(points).query_ball_point(points, _NEAR_M) if len(points) else ()):
        shown = np.unique((moments[near] - moments[number]) % count)
        stands[number] = away[shown].sum() >= max(_STANDING * away.sum(), 1)
    return [points[(moments == moment) & ~stands] for moment in ahead]


def _near(points: FloatArray, others: FloatArray) -> int:
    if not len(points) or not len(others):
        return 0
    apart = np.linalg.norm(points[:, None] - others, axis=2)
    return int((apart.min(axis=1) <= _NEAR_M).sum())
