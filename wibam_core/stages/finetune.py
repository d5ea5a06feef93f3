"""Fine-tune the monocular detector on the site's own multi-view boxes."""

from __future__ import annotations

from dataclasses import asdict

from wibam_core.artifacts.catalogue import ANNOTATIONS, CURVES, FITS, FRAMES, RIG, SPLIT, WEIGHTS, WEIGHTS_ONNX
from wibam_core.config import FinetuneConfig
from wibam_core.dataset.sufficiency import Sufficiency, training_sufficiency
from wibam_core.documents.curves import Curves
from wibam_core.models.weights import bundled
from wibam_core.networks.registry import load_to_train, save_network
from wibam_core.stages.base import StageContext, Summary
from wibam_core.training.calibration import sd_factors
from wibam_core.training.dataset import SiteView, site_views
from wibam_core.training.device import choose_device
from wibam_core.training.finetune import FinetuneResult, SiteDataset, finetune
from wibam_core.training.teachable import Teachable
from wibam_core.training.trainable import TrainableNetwork


def run(context: StageContext, config: FinetuneConfig) -> Summary:
    """Write `WEIGHTS`, where the network's family has ONNX files `WEIGHTS_ONNX`, too, and `CURVES`.

    The weights carry a `ModelCard`: what they are, and how they are to be used.
    """
    choose_device(config.device)  # before anything is read
    custom = config.network == "custom"
    start = context.assets["network"] if custom else bundled("mono_small.safetensors")
    network = load_to_train(start, config)
    instants, fits = context.read(ANNOTATIONS), context.read(FITS)
    taught = Teachable.of(instants, fits, network.known)
    dataset, enough = _dataset(context, config, network, taught)
    enough.require_any()
    context.warn(*enough.cautions, *taught.cautions())
    result = finetune(network, dataset, config, context.progress, context.scratch)
    network.card = network.card.model_copy(
        update={
            "decode": config.decode,
            "sd_factors": asdict(sd_factors(network, dataset, config.decode)),
            "start": config.network,
            "method": config.method,
            "device": config.device,
        }
    )
    save_network(network, context.new_file(WEIGHTS))
    exported = network.onnx()
    if exported is not None:
        context.new_file(WEIGHTS_ONNX).write_bytes(exported)
    context.write(CURVES, Curves(kept=result.kept, kept_step=result.kept_step, epochs=list(result.epochs)))
    return _summary(dataset, result) | {"vehicles": enough.vehicles}


def _dataset(
    context: StageContext, config: FinetuneConfig, network: TrainableNetwork, taught: Teachable
) -> tuple[SiteDataset, Sufficiency]:
    rig, frames, split = context.read(RIG), context.read(FRAMES), context.read(SPLIT)
    width_px = network.view_width_px
    complete = config.method != "paper"  # which learns from detections alone

    def subset(name: str) -> list[SiteView]:
        times = set(split.times_ns[name])
        chosen = [instant for instant in taught.instants if instant.time_ns in times]
        return site_views(
            chosen,
            frames,
            taught.fits,
            rig,
            split.left_out_tracks[name],
            width_px,
            complete=complete,
            not_looked_for=taught.not_looked_for,
        )

    enough = training_sufficiency(config.method, taught.instants, taught.fits, split)
    return SiteDataset(frames, rig, subset("train"), subset("val")), enough


def _summary(dataset: SiteDataset, result: FinetuneResult) -> Summary:
    first, last = result.epochs[0], result.epochs[-1]
    return {
        "train_frames": len(dataset.train),
        "validation_frames": len(dataset.validation),
        "pseudo_labels_3d": int(sum((view.pseudo_labels.confidence > 0).sum() for view in dataset.train)),
        "boxes_2d": int(sum(len(view.pseudo_labels.classes) for view in dataset.train)),
        "kept": result.kept,
        "kept_step": result.kept_step,
        "first_loss": round(first.train["total"], 4),
        "last_loss": round(last.train["total"], 4),
    }
