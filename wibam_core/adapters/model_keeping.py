"""Keeping networks: taken from jobs that made them, or from files that were uploaded."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
from pathlib import Path
from typing import Any

from wibam_core.adapters import records
from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.glimpses import GlimpseRequest, Glimpses
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.model_store import ModelStore, NewModel
from wibam_core.adapters.results import JobResults
from wibam_core.adapters.site_store import SiteStore
from wibam_core.artifacts.catalogue import CONFLICTS, METRICS, USUAL, WEIGHTS, WEIGHTS_ONNX
from wibam_core.config import PipelineConfig
from wibam_core.documents.model_card import ModelCard
from wibam_core.documents.trained_model import ModelDocument, ModelMetrics, Parent, Training
from wibam_core.errors import InputError, NotFound, WibamError
from wibam_core.formats.model_card import read_card
from wibam_core.jobs.records import Job, Purpose, StoredFile, TrainedModel

_log = logging.getLogger(__name__)
WEIGHTS_FILE, USUAL_FILE = "weights.safetensors", "usual.npz"
#: The conflicts of the job that made a network say how tracks err there.
TRACK_ERRORS_FILE = "conflicts.json"
_ONNX = "weights.onnx"


class ModelKeeper:
    """Networks with their files.

    Args:
        models: what is known of them.
        jobs, sites, results, folder, glimpses: of the service.
    """

    def __init__(
        self,
        models: ModelStore,
        jobs: JobStore,
        sites: SiteStore,
        results: JobResults,
        folder: DataFolder,
        glimpses: Glimpses,
    ) -> None:
        self._models = models
        self._jobs = jobs
        self._sites = sites
        self._results = results
        self._folder = folder
        self._glimpses = glimpses
        self._given_up: set[tuple[str, str]] = set()

    def keep_all(self) -> None:
        """Keep the networks of all jobs that have one which is not kept yet."""
        for job_id, stage_hash in self._models.jobs_to_keep():
            if (job_id, stage_hash) in self._given_up:
                continue
            try:
                self.keep_of_job(self._jobs.job(job_id))
            except OSError as error:  # the next round tries again
                _log.warning("the network of %s could not be kept: %s", job_id, error)
            except WibamError as error:
                _log.warning("the network of %s cannot be kept: %s", job_id, error)
                self._given_up.add((job_id, stage_hash))

    def keep_of_job(self, job: Job) -> TrainedModel | None:
        """Keep the network of a job; None where it is kept already.

        Raises:
            NotFound, Conflict: the job has not made it, or its outputs are gone.
        """
        weights, finetune = self._results.file(job, WEIGHTS), job.stage(WEIGHTS.stage)
        assert finetune is not None
        finished = self._results.finished(job)
        files = {WEIGHTS_FILE: weights.path}
        beside = ((_ONNX, WEIGHTS_ONNX), (USUAL_FILE, USUAL), (TRACK_ERRORS_FILE, CONFLICTS))
        files |= {name: finished.local(artifact) for name, artifact in beside if finished.has(artifact)}
        new = NewModel(
            id=records.new_id("model"),
            name=job.name or f"{job.site.name}, {job.id}",
            site_id=job.site_id,
            job_id=job.id,
            stage_hash=finetune.hash,
            sha256=weights.sha256,
            size_bytes=weights.size_bytes,
            has_onnx=_ONNX in files,
            has_usual=USUAL_FILE in files,
            document=self._document(job, weights.path),
        )
        self._place(new.id, files)
        kept = self._models.add(new)
        if kept is None:
            self._remove_files(new.id)
        return kept

    def keep_upload(self, file: StoredFile, name: str) -> TrainedModel:
        """Keep an uploaded network, once a confined process has found that it is one; the upload is used up. Where the
        site has a network with the same file, it is that one.

        Raises:
            InputError: the file was uploaded for something else.
            InvalidWeights: it is no network of a family that is known.
            ServiceUnavailable: too many other files are being looked at.
        """
        if file.purpose is not Purpose.MODEL:
            raise InputError(
                f"the file was uploaded as {file.purpose}", hint="Upload it with the purpose 'model'.", file=file.id
            )
        kept = self._models.of_site_and_file(file.site_id, file.sha256)
        if kept is None:
            kept = self._keep_new(file, name)
        with contextlib.suppress(NotFound):
            self._sites.retire_file(file.site_id, file.id)
        return kept

    def _keep_new(self, file: StoredFile, name: str) -> TrainedModel:
        path = self._folder.file(file)
        answer, onnx = self._glimpses.look(GlimpseRequest(look="network", path=path))
        new = NewModel(
            id=records.new_id("model"),
            name=name or file.filename or "uploaded",
            site_id=file.site_id,
            job_id=None,
            stage_hash=None,
            sha256=file.sha256,
            size_bytes=file.size_bytes,
            has_onnx=bool(onnx),
            has_usual=False,
            document=ModelDocument(card=ModelCard.model_validate(answer["card"])),
        )
        self._place(new.id, {WEIGHTS_FILE: path})
        if onnx:
            (self._folder.model(new.id) / _ONNX).write_bytes(onnx)
        kept = self._models.add(new)
        if kept is None:  # somebody was faster with the same one
            self._remove_files(new.id)
            kept = self._models.of_site_and_file(file.site_id, file.sha256)
            assert kept is not None, "it is the reason why the new one is not kept"
        return kept

    def file(self, model: TrainedModel, format: str = "safetensors") -> Path:
        """The file of a network, as "safetensors" or "onnx".

        Raises:
            NotFound: it has none of that format, or the file is gone.
        """
        path = self._folder.model(model.id) / (_ONNX if format == "onnx" else WEIGHTS_FILE)
        if not path.is_file():
            raise NotFound(
                f"model {model.id} has no {format} file", hint="Networks of some families have safetensors files alone."
            )
        return path

    def usual(self, model: TrainedModel) -> Path | None:
        """What was usual where the network was made (`wibam_core.formats.usual`); None where that is not known."""
        path = self._folder.model(model.id) / USUAL_FILE
        return path if path.is_file() else None

    def delete(self, model_id: str) -> None:
        """Forget a network and remove its files. Raises as `ModelStore.delete` does."""
        self._models.delete(model_id)
        self._remove_files(model_id)

    def _place(self, model_id: str, files: dict[str, Path]) -> None:
        """Copies of files, or other names of theirs, in a network's folder: there as a whole or not at all."""
        folder = self._folder.model(model_id)
        partial = folder.with_name(f"{folder.name}.partial")
        partial.mkdir(parents=True)
        try:
            for name, source in files.items():
                try:
                    os.link(source, partial / name)  # published outputs and finished uploads never change
                except OSError:
                    shutil.copyfile(source, partial / name)
            partial.rename(folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)

    def _remove_files(self, model_id: str) -> None:
        shutil.rmtree(self._folder.model(model_id), ignore_errors=True)

    def _document(self, job: Job, weights: Path) -> ModelDocument:
        options = PipelineConfig.parse(job.options).finetune
        metrics = self._results.read(job, METRICS)
        return ModelDocument(
            card=read_card(weights),
            site_name=job.site.name,
            cameras=list(job.site.camera_ids),
            parent=self._parent(job, options.network),
            training=_training(job, options.model_dump(mode="json")),
            metrics=ModelMetrics(
                labels=metrics.labels,
                finetuned=metrics.finetuned,
                baseline=metrics.baseline,
                self_consistency=metrics.self_consistency,
            ),
        )

    def _parent(self, job: Job, network: str) -> Parent:
        given = job.assets.get("network")
        if network != "custom" or given is None:
            return Parent(name="bundled")
        known = self._models.of_file(given.sha256)
        return Parent(name=given.filename, sha256=given.sha256, model_id=None if known is None else known.id)


def _training(job: Job, options: dict[str, Any]) -> Training:
    def said(stage: str) -> dict[str, Any]:
        run = job.stage(stage)
        return dict(run.summary or {}) if run is not None else {}

    trained, subsets = said("finetune"), said("dataset").get("subsets", {})
    instants = {name: int(subset["instants"]) for name, subset in subsets.items() if "instants" in subset}
    return Training(
        options=options,
        instants=instants,
        frames=int(trained.get("train_frames", 0)),
        vehicles=trained.get("vehicles"),
        kept_step=trained.get("kept_step"),
    )
