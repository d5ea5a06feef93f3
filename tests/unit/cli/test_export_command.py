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
from wibam_core.errors import InputError, NotFound
from wibam_core.formats.labels import write_labels
from wibam_core.stages.store import StageStore

app = typer.Typer()
app.command()(export)


def site_folder(folder: Path, outputs: Path) -> Path:
    """A site of one camera and its labels, whose latest run has come to its tracks, by whatever options."""
    (folder / "recordings").mkdir(parents=True)
    (folder / "site.json").write_text(site_of(corner_rig(1)).model_dump_json())
    (folder / "recordings" / "cam1.mp4").write_bytes(b"not looked at")
    write_labels(folder / "labels.parquet", content().labels or ())
    store = StageStore(outputs)
    store.remember({"track": "a" * 64, "safety": "b" * 64})
    attempt = store.begin("track", "a" * 64)
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


def test_outputs_elsewhere_are_told_as_to_run(tmp_path: Path) -> None:
    site = site_folder(tmp_path / "crossing", tmp_path / "elsewhere")
    wibam_export(str(site), "ssam", "--out", str(tmp_path / "my.trj"), "--outputs", str(tmp_path / "elsewhere"))
    assert (tmp_path / "my.trj").stat().st_size > 0
    with pytest.raises(NotFound, match="nothing was run in"):
        wibam_export(str(site), "ssam", "--out", str(tmp_path / "no.trj"))
    assert not (tmp_path / "no.trj").exists()


def test_what_the_latest_run_has_not_made_yet_is_not_taken_from_another(tmp_path: Path) -> None:
    site = site_folder(tmp_path / "crossing", tmp_path / "crossing" / "outputs")
    StageStore(site / "outputs").remember({"track": "c" * 64})
    with pytest.raises(InputError, match="without tracks"):
        wibam_export(str(site), "ssam", "--out", str(tmp_path / "no.trj"))
