"""Fine-tune the monocular detector on the site's own multi-view boxes."""

from __future__ import annotations

import json
from dataclasses import asdict

from wibam_core.config import FinetuneConfig
from wibam_core.dataset.split import Split
from wibam_core.dataset.sufficiency import Sufficiency, training_sufficiency
from wibam_core.formats.annotations import read_annotations
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.rig import read_rig
from wibam_core.formats.vehicles3d import read_vehicles3d
from wibam_core.models.frames import INPUT_WIDTH_PX
from wibam_core.models.usage import Usage
from wibam_core.networks.small.architecture import SmallNetwork
from wibam_core.networks.small.export import export_small
from wibam_core.networks.weights import bundled, load_centertrack, load_network, origin_of, save_network
from wibam_core.stages.base import StageContext, Summary
from wibam_core.stages.graph import require_network
from wibam_core.training.calibration import sd_factors
from wibam_core.training.dataset import SiteView, site_views
from wibam_core.training.device import choose_device
from wibam_core.training.finetune import FinetuneResult, SiteDataset, finetune


def run(context: StageContext, config: FinetuneConfig) -> Summary:
    """Write ``weights.safetensors``, the small network as ``weights.onnx``, too, and ``curves.json``.

    The weights say themselves how boxes are to be placed and by how much their standard deviations err: see `Usage`.
    ``curves.json`` is ``{"method", "decode", "network", "input_width_px", "device", "kept", "kept_step", "warnings":
    [sentence], "epochs": [{"step", "learning_rate", "train", "validation"}], "sd_factors"}``, where train and
    validation map the parts of the loss and ``total`` to their means, `SdFactors` says what the network's standard
    deviations are to be multiplied with, and ``input_width_px`` how wide a small network sees the images.
    """
    choose_device(config.device)  # before anything is read
    require_network(config, context.assets)
    custom = config.network == "custom"
    start = context.assets["network"] if custom else bundled("mono_small.safetensors")
    network = load_centertrack(start) if custom else load_network(start)
    dataset, enough = _dataset(context, config)
    enough.require_any()
    result = finetune(network, dataset, config, context.progress, context.scratch)
    factors = asdict(sd_factors(result.network, dataset, config.decode))
    usage = Usage(config.decode, factors)
    save_network(result.network, context.output / "weights.safetensors", origin_of(start) | usage.metadata())
    if isinstance(result.network, SmallNetwork):
        export_small(result.network, context.output / "weights.onnx", usage)
    curves = {
        "method": config.method,
        "decode": config.decode,
        "network": config.network,
        "input_width_px": None if custom else dataset.input_width_px,
        "device": config.device,
        "kept": result.kept,
        "kept_step": result.kept_step,
        "warnings": enough.warnings,
        "epochs": [asdict(epoch) for epoch in result.epochs],
        "sd_factors": factors,
    }
    (context.output / "curves.json").write_text(json.dumps(curves, indent=1, allow_nan=False), encoding="utf-8")
    return _summary(dataset, result) | {"vehicles": enough.vehicles, "warnings": enough.warnings}


def _dataset(context: StageContext, config: FinetuneConfig) -> tuple[SiteDataset, Sufficiency]:
    rig = read_rig(context.upstream["calibrate"] / "rig.json")
    frames = FrameStore(context.upstream["frames"])
    instants = read_annotations(context.upstream["associate"] / "annotations.parquet")
    lifts = read_vehicles3d(context.upstream["lift"] / "lifts.parquet")
    split = Split.from_json(json.loads((context.upstream["dataset"] / "split.json").read_text(encoding="utf-8")))

    width_px = config.input_width_px or INPUT_WIDTH_PX
    complete = config.method != "paper"  # which learns from detections alone

    def subset(name: str) -> list[SiteView]:
        times = set(split.times_ns[name])
        chosen = [instant for instant in instants if instant.time_ns in times]
        return site_views(chosen, frames, lifts, rig, split.left_out_tracks[name], width_px, complete=complete)

    enough = training_sufficiency(config.method, instants, lifts, split)
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
