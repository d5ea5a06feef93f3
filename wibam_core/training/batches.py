"""The batches of a fine-tuning: which views, how they are changed, and which windows of them a step sees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wibam_core.config import FinetuneConfig
from wibam_core.training.augment import jitter_colour, mirror, shake
from wibam_core.training.crops import crop, windows
from wibam_core.training.dataset import SiteView
from wibam_core.training.views import LabelledView

#: This share of the views is turned and zoomed a little; the others are seen as the camera hangs, as they will be after
#: training.
SHAKEN_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class Batch:
    """What a step learns from.

    Attributes:
        views: windows of images, with what is known about them.
        sources: the same vehicles in pixels of the whole images, and the other views of them.
        mirrored: which of the windows are mirrored, while ``sources`` are not.
    """

    views: list[LabelledView]
    sources: list[SiteView]
    mirrored: list[bool]


class Batches:
    """Draws batches. All follow from the seed and a number alone: nothing needs to be stored to resume.

    Args:
        views: labelled frames.
        reader: the number of one of them -> that view in pixels of the network's input, with its image.
        config: method, batch size, windows and seed.
    """

    def __init__(
        self, views: Sequence[SiteView], reader: Callable[[int], LabelledView], config: FinetuneConfig
    ) -> None:
        self._views = views
        self._reader = reader
        self._config = config

    def numbers(self, step: int) -> list[int]:
        """The numbers of a step's views, from a fresh shuffle every time all were seen."""
        size, total = self._config.batch_size, len(self._views)
        numbers: list[int] = []
        for place in range(step * size, (step + 1) * size):
            order = np.random.default_rng([self._config.seed, 0, place // total]).permutation(total)
            numbers.append(int(order[place % total]))
        return numbers

    def to_learn(self, step: int) -> Batch:
        """A step's views, changed at random."""
        rng = np.random.default_rng([self._config.seed, 1, step])
        views: list[LabelledView] = []
        sources: list[SiteView] = []
        mirrored: list[bool] = []
        for number in self.numbers(step):
            view, source = self._reader(number), self._views[number]
            mirrored.append(bool(rng.random() < 0.5))
            if self._config.method != "paper" and rng.random() < SHAKEN_SHARE:
                view = shake(view, rng)
                source = source.alone(view)
            views.append(view)
            sources.append(source)
        batch = self._windows(views, sources, mirrored, rng)
        seen = [mirror(view) if turned else view for view, turned in zip(batch.views, mirrored, strict=True)]
        return replace(batch, views=[replace(view, image=jitter_colour(view.image, rng)) for view in seen])

    def to_judge(self, first: int, end: int) -> Batch:
        """The views of these numbers as they are, each time in the same windows."""
        rng = np.random.default_rng([self._config.seed, 2, first])
        sources = list(self._views[first:end])
        views = [self._reader(number) for number in range(first, first + len(sources))]
        return self._windows(views, sources, [False] * len(sources), rng)

    def _windows(
        self, views: list[LabelledView], sources: list[SiteView], mirrored: list[bool], rng: np.random.Generator
    ) -> Batch:
        chosen = windows(views, self._config.crop_share, rng)
        parts = [crop(view, window) for view, window in zip(views, chosen, strict=True)]
        kept = [source.where(rows) for source, (_, rows) in zip(sources, parts, strict=True)]
        return Batch([part for part, _ in parts], kept, mirrored)
