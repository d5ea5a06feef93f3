"""Fine-tune the monocular detector on the site's own multi-view boxes."""

from __future__ import annotations

from dataclasses import asdict

from wibam_core.artifacts.catalogue import ANNOTATIONS, CURVES, FITS, FRAMES, RIG, SPLIT, WEIGHTS, WEIGHTS_ONNX
from wibam_core.config import FinetuneConfig
from wibam_core.dataset.sufficiency import Sufficiency, training_sufficiency
from wibam_core.documents.curves import Curves
from wibam_core.models.frames import INPUT_WIDTH_PX
from wibam_core.models.usage import Usage
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.export import export_small
from wibam_core.networks.weights import bundled, load_centertrack, load_network, origin_of, save_network
from wibam_core.stages.base import StageContext, Summary
from wibam_core.training.calibration import sd_factors
from wibam_core.training.dataset import SiteView, site_views
from wibam_core.training.device import choose_device
from wibam_core.training.finetune import FinetuneResult, SiteDataset, finetune


def run(context: StageContext, config: FinetuneConfig) -> Summary:
    """Write `WEIGHTS`, for the small network `WEIGHTS_ONNX`, too, and `CURVES`.

    The weights say themselves how boxes are to be placed and by how much their standard deviations err: see `Usage`.
    """
    choose_device(config.device)  # before anything is read
    custom = config.network == "custom"
    start = context.assets["network"] if custom else bundled("mono_small.safetensors")
    network = load_centertrack(start) if custom else load_network(start)
    dataset, enough = _dataset(context, config)
    enough.require_any()
    context.warn(*enough.cautions)
    result = finetune(network, dataset, config, context.progress, context.scratch)
    factors = asdict(sd_factors(result.network, dataset, config.decode))
    usage = Usage(config.decode, factors)
    save_network(result.network, context.new_file(WEIGHTS), origin_of(start) | usage.metadata())
    if isinstance(result.network, SmallNetwork):
        export_small(result.network, context.new_file(WEIGHTS_ONNX), usage)
    curves = Curves(
        method=config.method,
        decode=config.decode,
        network=config.network,
        input_width_px=None if custom else dataset.input_width_px,
        device=config.device,
        sd_factors=factors,
        kept=result.kept,
        kept_step=result.kept_step,
        epochs=list(result.epochs),
    )
    context.write(CURVES, curves)
    return _summary(dataset, result) | {"vehicles": enough.vehicles}


def _dataset(context: StageContext, config: FinetuneConfig) -> tuple[SiteDataset, Sufficiency]:
    rig, frames = context.read(RIG), context.read(FRAMES)
    instants, fits, split = context.read(ANNOTATIONS), context.read(FITS), context.read(SPLIT)

    width_px = config.input_width_px or INPUT_WIDTH_PX
    complete = config.method != "paper"  # which learns from detections alone

    def subset(name: str) -> list[SiteView]:
        times = set(split.times_ns[name])
        chosen = [instant for instant in instants if instant.time_ns in times]
        return site_views(chosen, frames, fits, rig, split.left_out_tracks[name], width_px, complete=complete)

    enough = training_sufficiency(config.method, instants, fits, split)
    return SiteDataset(frames, rig, subset("train"), subset("val")), enough


def _summary(dataset: SiteDataset, result: FinetuneResult) -> Summary:
    first, last = result.epochs[0], result.epochs[-1]
    return {
        "train_frames": len(dataset.train),
        "validation_frames": len(dataset.validation),
        "labels_3d": int(sum((view.labels.confidence > 0).sum() for view in dataset.train)),
        "boxes_2d": int(sum(len(view.labels.classes) for view in dataset.train)),
        "kept": result.kept,
        "kept_step": result.kept_step,
        "first_loss": round(first.train["total"], 4),
        "last_loss": round(last.train["total"], 4),
    }
