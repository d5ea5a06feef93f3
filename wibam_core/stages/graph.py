"""The pipeline as a graph. Pure: importing this module imports no stage.

A stage's outputs are addressed by a hash of everything they depend on: its code, its options, its part of the
site description, the files it reads and the hashes of the stages before it. Nothing else can change them, so a
job restarts from the first stage whose hash is not in the store. ``hash`` means this address wherever it stands; that
of a file's content is its SHA-256, or digest.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from wibam_core.artifacts import catalogue
from wibam_core.artifacts.artifact import Artifact
from wibam_core.artifacts.catalogue import made_by
from wibam_core.config import FinetuneConfig, PipelineConfig, StageConfig
from wibam_core.errors import UnknownOption
from wibam_core.job_kind import JobKind
from wibam_core.site import Site
from wibam_core.stages import depends
from wibam_core.stages.assets import ASSETS, require_assets
from wibam_core.stages.code import code_digest


@dataclass(frozen=True)
class FrameByFrame:
    """That a stage makes something of each frame by itself, so that it can be copied where it was made before.

    Attributes:
        options: of the stage, that only say which frames it works on.
        stages: before it, whose outputs only say that.
    """

    options: frozenset[str]
    stages: frozenset[str] = frozenset()


@dataclass(frozen=True)
class StageSpec:
    """One stage.

    Attributes:
        name: of the module in `wibam_core.stages`, of the options in `PipelineConfig`, and of the output folder.
        title: what it does, for a person.
        reads: the artifacts of other stages that it reads; the edges of the graph follow from them.
        reads_if_wide: those that it reads only of a site that has a camera with a wide lens.
        site_part: what of the site description it depends on.
        reads_recordings: whether it opens the uploaded videos.
        assets: other uploaded files (`wibam_core.stages.assets`) that it reads where the options use them.
        asset_checks: modules of wibam_core that it only checks assets with: both can make it fail, but change nothing
            that it writes.
        checked_options: those of fine-tuning that it checks the site's own network against; what it writes is the same
            for all.
        other_options: those of other stages that it uses, too.
        frame_by_frame: how it works on single frames; None where it does not.
        module: of the package `wibam_core.stages`, where that is not called as the stage is.
    """

    name: str
    title: str
    reads: tuple[Artifact[Any], ...] = ()
    site_part: Callable[[Site], Any] = depends.nothing
    reads_recordings: bool = False
    assets: tuple[str, ...] = ()
    asset_checks: frozenset[str] = frozenset()
    checked_options: Callable[[PipelineConfig], FinetuneConfig | None] = depends.no_options
    other_options: Callable[[PipelineConfig], tuple[StageConfig, ...]] = depends.no_others
    frame_by_frame: FrameByFrame | None = None
    reads_if_wide: tuple[Artifact[Any], ...] = ()
    module: str = ""

    @property
    def module_name(self) -> str:
        """The module of `wibam_core.stages` that does the work."""
        return self.module or self.name

    @property
    def requires(self) -> tuple[str, ...]:
        """Stages whose outputs it always reads."""
        return tuple(dict.fromkeys(artifact.stage for artifact in self.reads))

    def requires_of(self, site: Site) -> tuple[str, ...]:
        """Stages whose outputs it reads of a site."""
        if not any(camera.is_wide for camera in site.cameras):
            return self.requires
        return tuple(dict.fromkeys((*self.requires, *(artifact.stage for artifact in self.reads_if_wide))))

    @property
    def writes(self) -> tuple[Artifact[Any], ...]:
        """The artifacts that it makes."""
        return made_by(self.name)

    def code(self, *, checks: bool = True) -> str:
        """Digest of the code that its outputs depend on, and with ``checks`` of that which only checks assets.

        The modules that say how the artifacts look that it reads and writes are part of it.
        """
        read = (*self.reads, *self.reads_if_wide)
        layouts = frozenset(artifact.codec.layout for artifact in (*read, *self.writes))
        return code_digest(self.module_name, frozenset() if checks else self.asset_checks, layouts)

    def config(self, config: PipelineConfig) -> StageConfig:
        """This stage's part of the options, or what follows from those of others."""
        part = getattr(config, self.name)
        assert isinstance(part, StageConfig)
        return part

    def assets_read(self, config: PipelineConfig) -> tuple[str, ...]:
        """Which of its ``assets`` it reads with these options. What they don't use changes no address."""
        return tuple(name for name in self.assets if ASSETS[name].is_used(config))


_SPECS = (
    StageSpec(
        "preflight",
        "Check the recordings",
        site_part=depends.sizes,
        reads_recordings=True,
        assets=("labels", "detector", "network"),
        asset_checks=frozenset({"formats.labels", "detection.detector", "networks.registry"}),
        checked_options=depends.of_network,
    ),
    StageSpec("calibrate", "Calibrate the cameras", (), depends.calibration),
    StageSpec(
        "sync",
        "Synchronise the cameras",
        (catalogue.PROBE, catalogue.CALIBRATED_RIG),
        depends.signals,
        reads_recordings=True,
    ),
    StageSpec(
        "frames",
        "Read the frames",
        (catalogue.PROBE, catalogue.TIMESTAMPS, catalogue.LIMITS, catalogue.CLOCKS),
        depends.sizes,
        reads_recordings=True,
        frame_by_frame=FrameByFrame(frozenset({"rate_hz"}), frozenset({"preflight", "sync"})),
        reads_if_wide=(catalogue.CALIBRATED_RIG,),
    ),
    StageSpec(
        "detect",
        "Detect vehicles in 2D",
        (catalogue.TIMESTAMPS, catalogue.FRAMES),
        assets=("detector",),
        frame_by_frame=FrameByFrame(frozenset({"rate_hz"})),
        reads_if_wide=(catalogue.CALIBRATED_RIG,),
    ),
    StageSpec(
        "rounds",
        "Find, fit, teach, and find again",
        (
            catalogue.TIMESTAMPS,
            catalogue.CALIBRATED_RIG,
            catalogue.RESIDUALS,
            catalogue.FRAMES,
            catalogue.DETECTIONS,
            catalogue.SEARCHED_INSTANTS,
        ),
        other_options=depends.of_rounds,
    ),
    StageSpec(
        "refine",
        "Refine the calibration by the traffic",
        (
            catalogue.CALIBRATED_RIG,
            catalogue.RESIDUALS,
            catalogue.SEARCHED_INSTANTS,
            catalogue.ROUND_DETECTIONS,
            catalogue.ROUNDS,
            catalogue.DETECTOR_RIG,
            catalogue.DETECTOR_REFINEMENT,
        ),
    ),
    StageSpec(
        "associate",
        "Associate views and link over time",
        (catalogue.RIG, catalogue.REFINEMENT, catalogue.ROUND_DETECTIONS, catalogue.SEARCHED_INSTANTS),
    ),
    StageSpec("dataset", "Split in time", (catalogue.RIG, catalogue.ANNOTATIONS)),
    StageSpec("lift", "Fit 7DoF boxes to all views", (catalogue.RIG, catalogue.ANNOTATIONS, catalogue.SPLIT)),
    StageSpec(
        "finetune",
        "Fine-tune the 3D detector",
        (catalogue.RIG, catalogue.FRAMES, catalogue.ANNOTATIONS, catalogue.SPLIT, catalogue.FITS),
        assets=("network",),
    ),
    StageSpec(
        "predict",
        "Detect in 3D with what was learned",
        (catalogue.RIG, catalogue.FRAMES, catalogue.SPLIT, catalogue.WEIGHTS),
    ),
    StageSpec(
        "evaluate",
        "Evaluate",
        (
            catalogue.RIG,
            catalogue.FRAMES,
            catalogue.ANNOTATIONS,
            catalogue.SPLIT,
            catalogue.WEIGHTS,
            catalogue.PREDICTIONS,
        ),
        assets=("labels", "network"),
    ),
    StageSpec(
        "track",
        "Track in 7DoF",
        (catalogue.RIG, catalogue.FRAMES, catalogue.PREDICTIONS),
    ),
    StageSpec("safety", "Find conflicts", (catalogue.SPLIT, catalogue.FITS, catalogue.TRACKS)),
    StageSpec(
        "report",
        "Write the report",
        (
            catalogue.PROBE,
            catalogue.CHANGES,
            catalogue.RIG,
            catalogue.RESIDUALS,
            catalogue.REFINEMENT,
            catalogue.FRAMES,
            catalogue.DETECTION_STATISTICS,
            catalogue.ROUNDS,
            catalogue.ANNOTATIONS,
            catalogue.ASSOCIATION_STATISTICS,
            catalogue.SPLIT,
            catalogue.DATASET_STATISTICS,
            catalogue.LIFT_STATISTICS,
            catalogue.WEIGHTS,
            catalogue.CURVES,
            catalogue.METRICS,
            catalogue.PREDICTIONS_BASELINE,
            catalogue.PREDICTIONS_FINETUNED,
            catalogue.TRACKS,
            catalogue.CONFLICTS,
        ),
        site_part=depends.everything,
        assets=("labels",),
    ),
)

#: All stages by name, each after those it requires.
STAGES: Mapping[str, StageSpec] = MappingProxyType({spec.name: spec for spec in _SPECS})

#: Those of a run: new footage through a network that is there, without training. Where a stage is called as one of a
#: job, it makes the same artifacts, so that whoever shows a job's tracks and conflicts shows a run's.
RUN_STAGES: Mapping[str, StageSpec] = MappingProxyType(
    {name: STAGES[name] for name in ("preflight", "calibrate", "sync")}
    | {
        spec.name: spec
        for spec in (
            StageSpec(
                "track",
                "Track in 7DoF",
                (catalogue.PROBE, catalogue.CLOCKS, catalogue.CALIBRATED_RIG),
                reads_recordings=True,
                assets=("model", "usual", "open_tracks"),
                module="watch",
            ),
            StageSpec(
                "safety",
                "Find conflicts",
                (catalogue.TRACKS, catalogue.WATCHED),
                assets=("track_errors",),
                module="watch_safety",
            ),
        )
    }
)
#: The stages of each kind of job.
STAGES_OF: Mapping[JobKind, Mapping[str, StageSpec]] = MappingProxyType(
    {JobKind.TRAINING: STAGES, JobKind.RUN: RUN_STAGES}
)


@dataclass(frozen=True)
class InputDigests:
    """SHA-256 (hex) of the uploaded files: recordings by camera id, assets by name, outputs that are given by stage."""

    recordings: Mapping[str, str]
    assets: Mapping[str, str]
    given: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True)
class PlannedStage:
    """A stage that a job is to have.

    Attributes:
        name: which.
        hash: the address of its outputs.
        requires: the stages whose outputs it reads.
        frame_hash: of all that says what it makes of one frame, but not of what says which frames those are: outputs
            of one such hash hold the same of each frame. None for a stage that does not work frame by frame.
    """

    name: str
    hash: str
    requires: tuple[str, ...]
    frame_hash: str | None = None


def plan(
    site: Site, config: PipelineConfig, inputs: InputDigests, kind: JobKind = JobKind.TRAINING
) -> tuple[PlannedStage, ...]:
    """All stages of a job in order, with the addresses of their outputs.

    Assets that a stage only checks, and what it checks them with, belong to its own address, so that new ones are
    checked, but not to those of the stages after it: new labels train nothing again. A stage that is given has the
    address of what is given, and rests on nothing.

    Raises:
        InputError: the options ask for a file that was not given.
    """
    if kind is JobKind.TRAINING:
        require_assets(config, inputs.assets)
    planned: list[PlannedStage] = []
    contents: dict[str, str] = {}
    frame_hashes: dict[str, str] = {}
    for spec in STAGES_OF[kind].values():
        if spec.name in inputs.given:
            contents[spec.name] = _hash_of({"stage": spec.name, "given": inputs.given[spec.name]})
            planned.append(PlannedStage(spec.name, contents[spec.name], ()))
            continue
        checked = spec.checked_options(config)
        facts = {
            "stage": spec.name,
            "code": spec.code(),
            "writes": {artifact.name: artifact.version for artifact in spec.writes},
            "options": spec.config(config).model_dump(),
            "checked": None if checked is None else checked.model_dump(),
            "other_options": [options.model_dump() for options in spec.other_options(config)],
            "site": spec.site_part(site),
            "recordings": dict(inputs.recordings) if spec.reads_recordings else None,
            "assets": {name: inputs.assets[name] for name in spec.assets_read(config) if name in inputs.assets},
            "upstream": {name: contents[name] for name in spec.requires_of(site)},
        }
        frame_hash = None
        if spec.frame_by_frame is not None:
            frame_hash = _hash_of(facts | _facts_of_frames(spec.frame_by_frame, facts, contents | frame_hashes))
            frame_hashes[spec.name] = frame_hash
        planned.append(PlannedStage(spec.name, _hash_of(facts), spec.requires_of(site), frame_hash))
        if spec.asset_checks:
            facts |= {"code": spec.code(checks=False), "assets": {}, "checked": None}
        contents[spec.name] = _hash_of(facts)
    return tuple(planned)


def _facts_of_frames(only: FrameByFrame, facts: Mapping[str, Any], contents: Mapping[str, str]) -> dict[str, Any]:
    """Those of the facts, without what only says which frames, that differ from all facts."""
    options = {name: value for name, value in facts["options"].items() if name not in only.options}
    upstream = {name: contents[name] for name in facts["upstream"] if name not in only.stages}
    return {"options": options, "upstream": upstream}


def _hash_of(facts: Mapping[str, Any]) -> str:
    canonical = json.dumps(facts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(canonical.encode()).hexdigest()


def downstream(stage: str, stages: Sequence[StageSpec | PlannedStage] = _SPECS) -> tuple[str, ...]:
    """A stage and all that depend on it, directly or not, in order.

    Args:
        stage: its name.
        stages: all there are, each after those it requires.

    Raises:
        UnknownOption: if there is no such stage.
    """
    names = [spec.name for spec in stages]
    if stage not in names:
        raise UnknownOption(f"there is no stage {stage!r}", hint=f"The stages are {', '.join(names)}.", stage=stage)
    found = {stage}
    for spec in stages:
        if found.intersection(spec.requires):
            found.add(spec.name)
    return tuple(name for name in names if name in found)
