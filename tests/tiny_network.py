"""A third 3D network, as small as one can be: cars on a coarse grid, placed by the plane, trained by their fits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from wibam_core.config import FinetuneConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.formats.framestore import FrameStore
from wibam_core.geometry.torch_ops import CameraTensors, intersect_plane
from wibam_core.models.frames import Frame, prepare_camera, prepare_image, to_input
from wibam_core.models.weights import load_state
from wibam_core.networks.family import Family
from wibam_core.placing import Decode
from wibam_core.road_users import RoadUserClass
from wibam_core.scene import Vehicles3D
from wibam_core.training.dataset import ImageCache, SiteView
from wibam_core.training.multiview import OtherViews
from wibam_core.training.views import LabelledView

#: Pixels of the input per cell.
CELL_PX = 32
CARD = ModelCard(family="tiny", classes=("car",), decode="plane", input_width_px=320)


class TinyNetwork:
    """Says of each cell how surely a car's middle is in it, and the logarithm of its size."""

    default_rates: Mapping[str, float] = {"lifted": 0.05}
    states_sd = False
    known = frozenset({RoadUserClass.CAR})

    def __init__(self, card: ModelCard = CARD) -> None:
        self.card = card
        self.module = nn.Sequential(nn.Conv2d(3, 8, CELL_PX, CELL_PX), nn.ReLU(), nn.Conv2d(8, 4, 1))

    @classmethod
    def load(cls, path: Path, card: ModelCard) -> TinyNetwork:
        network = cls(card)
        load_state(network.module, path)
        return network

    @property
    def view_width_px(self) -> int:
        return self.card.input_width_px or 320

    def predict_each(
        self, frames: Iterable[Frame], *, decodes: Sequence[Decode], min_score: float
    ) -> Iterator[tuple[Vehicles3D, ...]]:
        for frame in frames:
            image = prepare_image(frame.image, self.view_width_px)
            with torch.inference_mode():
                said = self.module(to_input(image[None]))[0].double()
            scores = said[0].sigmoid()
            rows, columns = torch.nonzero(scores >= min_score, as_tuple=True)
            sizes_m = said[1:, rows, columns].T.clamp(-1, 3).exp()
            pixels = (torch.stack([columns, rows], dim=1) + 0.5) * CELL_PX - 0.5
            camera = CameraTensors.from_cameras([prepare_camera(frame.camera, self.view_width_px)], torch.float64)
            seen_by = camera[torch.zeros(len(rows), dtype=torch.long)]
            places = intersect_plane(seen_by, pixels, sizes_m[:, 2] / 2)
            boxes = torch.cat([places, sizes_m, torch.zeros(len(rows), 1)], dim=1).numpy()
            classes = np.full(len(rows), RoadUserClass.CAR.number)
            found = Vehicles3D.of(
                frame.time_ns,
                boxes,
                classes=classes,
                scores=scores[rows, columns].numpy(),
                camera_id=frame.camera_id,
            )
            yield (found,) * len(decodes)

    def reader(self, cache: Path, views: Sequence[SiteView], frames: FrameStore) -> Callable[[int], LabelledView]:
        return ImageCache(cache, views, frames).view

    def maps(self, views: Sequence[LabelledView], share: slice) -> dict[str, Tensor]:
        return {"said": self.module(to_input(np.stack([view.image for view in views[share]]))).float()}

    def losses(
        self, maps: Mapping[str, Tensor], views: Sequence[LabelledView], others: OtherViews, config: FinetuneConfig
    ) -> dict[str, Tensor]:
        said = maps["said"].double()
        wanted, sizes = torch.zeros_like(said[:, 0]), [said.sum() * 0]
        for number, view in enumerate(views):
            middles = (view.boxes2d[:, :2] + view.boxes2d[:, 2:]) / 2
            columns, rows = np.floor((middles + 0.5) / CELL_PX).astype(int).T
            for row, column, box in zip(rows, columns, view.boxes3d, strict=True):
                if 0 <= row < said.shape[2] and 0 <= column < said.shape[3] and np.isfinite(box).all():
                    wanted[number, row, column] = 1.0
                    sizes.append((said[number, 1:, row, column] - torch.tensor(np.log(box[3:6]))).abs().sum())
        parts = {
            "heat": functional.binary_cross_entropy_with_logits(said[:, 0], wanted, pos_weight=said.new_tensor(20.0)),
            "size": torch.stack(sizes).mean(),
        }
        return {**parts, "total": parts["heat"] + parts["size"]}

    def runnable(self, device: torch.device) -> TinyNetwork:
        return self

    def onnx(self) -> None:
        """It has no such file."""


FAMILY = Family(name="tiny", decodes=("plane",), methods=("lifted",), load=TinyNetwork.load)
