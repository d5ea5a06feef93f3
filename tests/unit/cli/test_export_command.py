"""`wibam export` on a site folder that `wibam run` worked on."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.builders import corner_rig, site_of
from tests.exchange_content import content
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.cli.export import export
from wibam_core.cli.run import parse_options
from wibam_core.config import PipelineConfig
from wibam_core.errors import InputError
from wibam_core.formats.labels import write_labels
from wibam_core.stages.graph import plan
from wibam_core.stages.runner import SiteFolder
from wibam_core.stages.store import StageStore

app = typer.Typer()
app.command()(export)


def site_folder(folder: Path, outputs: Path, *options: str) -> Path:
    """A site of one camera and its labels, whose tracks were made with these options."""
    (folder / "recordings").mkdir(parents=True)
    (folder / "site.json").write_text(site_of(corner_rig(1)).model_dump_json())
    (folder / "recordings" / "cam1.mp4").write_bytes(b"not looked at")
    write_labels(folder / "labels.parquet", content().labels or ())
    loaded = SiteFolder.load(folder)
    store = StageStore(outputs)
    planned = plan(loaded.site, PipelineConfig.parse(parse_options(list(options))), loaded.digests())
    (stage,) = (stage for stage in planned if stage.name == "track")
    attempt = store.begin(stage.name, stage.hash)
    ArtifactWriter("track", attempt.output, made_by("track")).write(catalogue.TRACKS, list(content().tracks or ()))
    store.publish(attempt, {}, 0.1)
    return folder


def wibam_export(*arguments: str) -> str:
    result = CliRunner().invoke(app, list(arguments), env={"COLUMNS": "300"})
    if result.exception is not None:
        raise result.exception
    return result.output


def test_the_tracks_of_a_folder_are_written_under_its_name(tmp_path: Path) -> None:
    site = site_folder(tmp_path / "crossing", tmp_path / "crossing" / "outputs")
    wibam_export(str(site), "levelx", "--out", str(tmp_path))
    with zipfile.ZipFile(tmp_path / "crossing-levelx.zip") as archive:
        assert archive.read("00_tracksMeta.csv").count(b"\n") == 1 + 3


def test_what_is_there_is_listed(tmp_path: Path) -> None:
    site = site_folder(tmp_path / "crossing", tmp_path / "crossing" / "outputs")
    lines = {line.split()[0]: line for line in wibam_export(str(site)).splitlines()}
    assert " - " in lines["levelx"]
    assert "boxes 2d" in lines["coco"]


def test_options_and_outputs_are_told_as_to_run(tmp_path: Path) -> None:
    site = site_folder(tmp_path / "crossing", tmp_path / "elsewhere", "finetune.steps=7")
    told = ("--outputs", str(tmp_path / "elsewhere"), "--set", "finetune.steps=7")
    wibam_export(str(site), "ssam", "--out", str(tmp_path / "my.trj"), *told)
    assert (tmp_path / "my.trj").stat().st_size > 0
    with pytest.raises(InputError, match="without tracks"):
        wibam_export(str(site), "ssam", "--out", str(tmp_path / "no.trj"), *told[:2])
    assert not (tmp_path / "no.trj").exists()
