"""Fine-tune the monocular detector on the site's own multi-view boxes."""

from __future__ import annotations

import json
from dataclasses import asdict

from wibam_core.config import FinetuneConfig
from wibam_core.dataset.split import Split
from wibam_core.formats.annotations import read_annotations
from wibam_core.formats.framestore import FrameStore
from wibam_core.formats.rig import read_rig
from wibam_core.formats.vehicles3d import read_vehicles3d
from wibam_core.models.weights import bundled, load_network, save_network
from wibam_core.stages.base import StageContext, Summary
from wibam_core.training.dataset import SiteView, site_views
from wibam_core.training.finetune import FinetuneResult, SiteDataset, finetune


def run(context: StageContext, config: FinetuneConfig) -> Summary:
    """Write ``weights.safetensors`` and ``curves.json``.

    ``curves.json`` is ``{"method", "decode", "kept", "kept_step", "epochs": [{"step", "learning_rate", "train",
    "validation"}]}``, where train and validation map the parts of the loss and ``total`` to their means.
    """
    dataset = _dataset(context)
    network = load_network(bundled("mono_small.safetensors"))
    result = finetune(network, dataset, config, context.progress, context.scratch)
    save_network(result.network, context.output / "weights.safetensors")
    curves = {
        "method": config.method,
        "decode": config.decode,
        "kept": result.kept,
        "kept_step": result.kept_step,
        "epochs": [asdict(epoch) for epoch in result.epochs],
    }
    (context.output / "curves.json").write_text(json.dumps(curves, indent=1), encoding="utf-8")
    return _summary(dataset, result)


def _dataset(context: StageContext) -> SiteDataset:
    rig = read_rig(context.upstream["calibrate"] / "rig.json")
    frames = FrameStore(context.upstream["frames"])
    instants = read_annotations(context.upstream["associate"] / "annotations.parquet")
    lifts = read_vehicles3d(context.upstream["lift"] / "lifts.parquet")
    split = Split.from_json(json.loads((context.upstream["dataset"] / "split.json").read_text(encoding="utf-8")))

    def subset(name: str) -> list[SiteView]:
        times = set(split.times_ns[name])
        chosen = [instant for instant in instants if instant.time_ns in times]
        return site_views(chosen, frames, lifts, rig, split.left_out_tracks[name])

    return SiteDataset(frames, rig, subset("train"), subset("val"))


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
