"""Compares two networks that jobs have made, by what these jobs have kept of their test parts."""

from __future__ import annotations

from dataclasses import dataclass

from wibam_core.adapters.files import DataFolder
from wibam_core.adapters.glimpses import ComparisonInputs, GlimpseRequest, Glimpses
from wibam_core.adapters.job_store import JobStore
from wibam_core.adapters.model_store import ModelStore
from wibam_core.adapters.results import JobResults
from wibam_core.artifacts import catalogue
from wibam_core.config import PipelineConfig
from wibam_core.documents.comparison import NetworkComparison
from wibam_core.errors import Conflict
from wibam_core.jobs.records import Job, TrainedModel

_MADE_BY_BOTH = (catalogue.FRAMES, catalogue.SPLIT, catalogue.PREDICTIONS_FINETUNED, catalogue.RIG)


@dataclass(frozen=True)
class Comparing:
    """What comparisons are made of: the service's stores, and the confined processes that read what is theirs."""

    models: ModelStore
    jobs: JobStore
    results: JobResults
    folder: DataFolder
    glimpses: Glimpses

    def compare(self, first_id: str, second_id: str) -> NetworkComparison:
        """Two networks on the instants that neither learned from. Cameras, annotations and options are those of the
        second one's job, and labels, too, where it has any.

        Raises:
            NotFound: there is no such network, or its job is gone.
            Conflict: a network was not made by a job as it is now, or the two jobs' recordings or test parts have
                nothing in common.
        """
        models = [self.models.model(model_id) for model_id in (first_id, second_id)]
        jobs = [self._job_of(model) for model in models]
        first, second = jobs
        if _recordings(first) != _recordings(second):
            raise Conflict(
                f"jobs {first.id} and {second.id} worked on different recordings",
                hint="Compare networks that were trained on the same ones.",
            )
        done = [self.results.finished(job) for job in jobs]
        labels = second.assets.get("labels") or first.assets.get("labels")
        known = [name for name in models[0].document.card.classes if name in models[1].document.card.classes]
        cautions = [caution for model in models if (caution := _start(model))]
        rigs = [self.results.file(job, catalogue.RIG).sha256 for job in jobs]
        if rigs[0] != rigs[1]:
            cautions.append("the two jobs refined the cameras differently; both are judged by the second's")
        stages = {artifact.stage for artifact in _MADE_BY_BOTH}
        inputs = ComparisonInputs(
            first={stage: done[0].folder(stage) for stage in stages},
            second={stage: done[1].folder(stage) for stage in (*stages, catalogue.ANNOTATIONS.stage)},
            labels=None if labels is None else self.folder.file(labels),
            config=PipelineConfig.parse(second.options).evaluate,
            known=tuple(known),
            cautions=tuple(cautions),
        )
        header, _ = self.glimpses.look(GlimpseRequest(look="comparison", comparison=inputs))
        return NetworkComparison.model_validate(header)

    def _job_of(self, model: TrainedModel) -> Job:
        if model.job_id is None:
            raise Conflict(
                f"model {model.id} was uploaded: it was seen on no held-out instants",
                hint="Start a job that fine-tunes from it; the job's metrics tell how it did before.",
            )
        job = self.jobs.job(model.job_id)
        for artifact in _MADE_BY_BOTH[:2]:
            self.results.finished(job).folder(artifact.stage)
        if self.results.file(job, catalogue.WEIGHTS).sha256 != model.sha256:
            raise Conflict(
                f"job {job.id} has made another network since model {model.id}", hint="Compare its newest model."
            )
        self.results.file(job, catalogue.PREDICTIONS_FINETUNED)
        return job


def _recordings(job: Job) -> dict[str, tuple[str, ...]]:
    return {camera: tuple(file.sha256 for file in files) for camera, files in job.recordings.items()}


def _start(model: TrainedModel) -> str:
    parent = model.document.parent
    if parent is None or parent.sha256 is None:
        return ""
    return f"{model.id} started from {parent.name}, which may have learned from these instants"
