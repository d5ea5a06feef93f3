"""Artifacts are declared once, and nobody but their catalogue knows their files."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.builders import site_of
from tests.stage_folders import StageFolders
from tests.unit.stages.test_graph import DIGESTS
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import ARTIFACTS, made_by
from wibam_core.config import PipelineConfig
from wibam_core.documents.recordings import Limits, Probe
from wibam_core.documents.tracks import TrackState
from wibam_core.formats.tracks import SCHEMA
from wibam_core.stages import graph
from wibam_core.stages.graph import STAGES

ROOT = Path(__file__).resolve().parents[3]
#: Modules with files of their own, which only happen to be called as artifacts are: the truth of a simulated site, the
#: networks that a service keeps, caches and tables of benchmarks, what `wibam track` writes, and the example in the
#: client's docstring.
_OWN_FILES = (
    "synthetic/recorder.py",
    "adapters/model_keeping.py",
    "benchmarks/lifting.py",
    "benchmarks/measure_network_errors.py",
    "benchmarks/queries.py",
    "cli/track.py",
    "client/__init__.py",
)


def test_names_and_places_are_unique() -> None:
    assert len({artifact.id for artifact in ARTIFACTS.values()}) == len(ARTIFACTS)
    assert all(artifact.title and artifact.codec.media_type for artifact in ARTIFACTS.values())
    assert {artifact.stage for artifact in ARTIFACTS.values()} == set(STAGES)


def test_no_other_module_spells_the_file_of_an_artifact() -> None:
    files = {artifact.file for artifact in ARTIFACTS.values() if "." in artifact.file}
    spelled = re.compile("|".join(rf'["/]{re.escape(file)}"' for file in sorted(files)))
    found = []
    for folder in ("api", "worker", "wibam_core", "benchmarks"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not name.startswith("wibam_core/artifacts/") and not any(own in name for own in _OWN_FILES):
                code = re.sub(r'""".*?"""|examples=\[.*?\]', "", path.read_text(encoding="utf-8"), flags=re.S)
                found += [f"{name}: {spelling}" for spelling in spelled.findall(code)]
    assert not found


def test_the_graph_follows_from_what_stages_read() -> None:
    for spec in STAGES.values():
        assert set(spec.requires) == {artifact.stage for artifact in spec.reads}
        assert all(artifact.codec.layout.startswith("wibam_core.") for artifact in spec.reads + spec.writes)


def test_a_stage_writes_what_it_declares_and_nothing_else(tmp_path: Path) -> None:
    writer = ArtifactWriter("preflight", tmp_path, made_by("preflight"))
    writer.write(catalogue.LIMITS, Limits(min_overlap_s=2.0))
    with pytest.raises(AssertionError, match="does not make <artifact tracks of track>"):
        writer.write(catalogue.TRACKS, [])


def test_a_stage_reads_the_outputs_of_the_stages_that_it_declares_alone(tmp_path: Path) -> None:
    folders = StageFolders(tmp_path)
    folders.give(catalogue.PROBE, Probe(cameras={}))
    reader = folders.context("safety", None).inputs  # type: ignore[arg-type]
    with pytest.raises(KeyError):
        reader.read(catalogue.PROBE)


def test_another_version_of_an_artifact_changes_the_address_of_its_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    before = graph.plan(site_of(), PipelineConfig(), DIGESTS)
    newer = replace(catalogue.TRACKS, version=2)
    monkeypatch.setattr(graph, "made_by", lambda stage: (newer,) if stage == "track" else made_by(stage))
    after = graph.plan(site_of(), PipelineConfig(), DIGESTS)
    assert {a.name for a, b in zip(after, before, strict=True) if a.hash != b.hash} == {"track", "safety", "report"}


def test_the_states_of_tracks_over_http_are_the_columns_of_the_file() -> None:
    fields = [field.alias or name for name, field in TrackState.model_fields.items()]
    assert fields == SCHEMA.names
