"""How wrong the standard deviations of a fine-tuned network are, told without a hand label.

The fits to all views in the validation part, which the network did not learn from, stand for the truth. They err
themselves: in position and heading at random, so that the factors are a little too large, and in size (z is half the
height) always the same way. A network learns that from the fits, and the error does not show; sizes are therefore never
said to be surer than the network says.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from wibam_core.config import EvaluateConfig
from wibam_core.evaluation.matching import match_on_ground
from wibam_core.evaluation.metrics import box_errors
from wibam_core.evaluation.uncertainty import SdFactors
from wibam_core.models.frames import Frame
from wibam_core.models.network import predict
from wibam_core.placing import Decode
from wibam_core.scene import Vehicles3D
from wibam_core.training.dataset import SiteView
from wibam_core.training.finetune import SiteDataset
from wibam_core.training.trainable import TrainableNetwork

#: This many views of the validation part are looked at, at most, evenly spread.
_MAX_VIEWS = 240
#: Weaker detections are left out, as they are when the network is evaluated.
_MIN_SCORE = EvaluateConfig().min_score
#: A detection farther than this from a fit is no match, m.
_MATCH_DISTANCE_M = 4.0


def sd_factors(network: TrainableNetwork, dataset: SiteDataset, decode: Decode) -> SdFactors:
    """What the network's standard deviations are to be multiplied with; 1 for a network that states none.

    Args:
        network: after training.
        dataset: only its validation part is looked at.
        decode: how boxes are placed.
    """
    if not network.states_sd:
        return SdFactors()
    views = dataset.validation[:: max(1, -(-len(dataset.validation) // _MAX_VIEWS))]
    return factors_from_fits(
        predict(network, _frames(dataset, views), decode=decode, min_score=_MIN_SCORE),
        views,
    )


def factors_from_fits(predictions: Iterable[Vehicles3D], views: Sequence[SiteView]) -> SdFactors:
    """The factors by which predictions err more than they say, against the fits of the same views, one by one."""
    errors, sd = [np.empty((0, 7))], [np.empty((0, 7))]
    for found, view in zip(predictions, views, strict=True):
        taught = view.pseudo_labels
        fitted = np.isfinite(taught.boxes3d).all(axis=1) & (taught.confidence > 0)
        fits = taught.boxes3d[fitted]
        match = match_on_ground(fits, np.ones(len(fits), bool), found.boxes, _MATCH_DISTANCE_M)
        made = box_errors(found.boxes[match.detections], fits[match.labels])
        made[~taught.front_known[fitted][match.labels], 6] = np.nan
        errors.append(made)
        sd.append(found.sd[match.detections])
    factors = SdFactors.of(np.concatenate(errors), np.concatenate(sd))
    return replace(factors, z=max(factors.z, 1.0), size=max(factors.size, 1.0))


def _frames(dataset: SiteDataset, views: Sequence[SiteView]) -> Iterator[Frame]:
    for view in views:
        image = dataset.frames.image(view.camera_id, view.time_ns)
        yield Frame(image, dataset.rig[view.camera_id], view.camera_id, view.time_ns)
