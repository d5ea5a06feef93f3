"""`wibam upload`, `jobs` and `tracks` against a real API."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.builders import corner_rig, site_of
from tests.finished import finished_job
from tests.service import TOKEN, LiveApi, live_api, settings_for
from wibam_core.cli import jobs
from wibam_core.cli.tracks import tracks
from wibam_core.cli.upload import upload
from wibam_core.errors import MissingCamera, NotFound, Unauthorised
from wibam_core.formats.tracks import read_tracks

runner = CliRunner()
app = typer.Typer()
app.command()(upload)
app.command()(tracks)
app.add_typer(jobs.app, name="jobs")


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    with live_api(settings_for(tmp_path_factory.mktemp("service"))) as running:
        yield running


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


def wibam(api: LiveApi, *arguments: str) -> str:
    result = runner.invoke(app, list(arguments), env={"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN, "COLUMNS": "200"})
    if result.exception is not None:
        raise result.exception
    return result.output


def site_folder(path: Path, cameras: int = 2, recordings: int = 2) -> Path:
    site = site_of(corner_rig(cameras))
    (path / "recordings").mkdir(parents=True)
    (path / "site.json").write_text(site.model_dump_json())
    for camera in site.camera_ids[:recordings]:
        (path / "recordings" / f"{camera}.mp4").write_bytes(b"video of " + camera.encode())
    return path


def test_a_site_folder_is_sent_whole(api: LiveApi, tmp_path: Path) -> None:
    folder = site_folder(tmp_path / "site")
    (folder / "labels.json").write_text("{}")
    (folder / "detector.onnx").write_bytes(b"onnx")
    site = wibam(api, "upload", str(folder)).split()[-1]
    sent = {(item["purpose"], item["camera"]) for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    assert sent == {("recording", "cam1"), ("recording", "cam2"), ("labels", None), ("detector", None)}
    plan = wibam(api, "jobs", "create", site, "--dry-run", "--set", "finetune.steps=5")
    assert "Fine-tune" in plan
    job = wibam(api, "jobs", "create", site).strip()
    assert job in wibam(api, "jobs", "list", "--site", site)
    assert "cancelled" in wibam(api, "jobs", "cancel", job)


def test_a_corrected_site_is_updated_and_only_what_differs_is_sent(api: LiveApi, tmp_path: Path) -> None:
    folder = site_folder(tmp_path / "site")
    site = wibam(api, "upload", str(folder)).split()[-1]
    first = {item["camera"]: item["id"] for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    corrected = site_of(corner_rig(2)).model_copy(update={"name": "Corrected"})
    (folder / "site.json").write_text(corrected.model_dump_json())
    (folder / "recordings" / "cam2.mp4").write_bytes(b"video of CAM2")
    (folder / "labels.json").write_text("{}")
    assert wibam(api, "upload", str(folder), "--site", site).split()[-1] == site
    assert api.http.get(f"/v1/sites/{site}").json()["name"] == "Corrected"
    files = {item["camera"]: item for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    assert files["cam1"]["id"] == first["cam1"]
    assert files["cam2"]["id"] != first["cam2"]
    assert files[None]["purpose"] == "labels"
    with pytest.raises(NotFound):
        wibam(api, "upload", str(folder), "--site", "site_0000000000000000")


def test_a_folder_without_a_recording_is_not_sent(api: LiveApi, tmp_path: Path) -> None:
    before = len(api.http.get("/v1/sites").json())
    with pytest.raises(MissingCamera):
        wibam(api, "upload", str(site_folder(tmp_path / "site", recordings=1)))
    assert len(api.http.get("/v1/sites").json()) == before


def test_without_a_token_the_hint_says_where_it_is(api: LiveApi) -> None:
    result = runner.invoke(app, ["jobs", "list"], env={"WIBAM_URL": api.url, "WIBAM_TOKEN": ""})
    assert isinstance(result.exception, Unauthorised)
    assert "wibam serve" in result.exception.hint


def test_a_finished_job_is_shown(api: LiveApi, job: str) -> None:
    assert "succeeded, 100% done" in wibam(api, "jobs", "show", job)
    assert "succeeded" in wibam(api, "jobs", "watch", job)
    api.services.folder.log(job).write_text("a line\n")
    assert wibam(api, "jobs", "log", job) == "a line\n"
    assert wibam(api, "jobs", "log", job, "--follow") == "a line\n"


def test_tracks_are_written(api: LiveApi, job: str, tmp_path: Path) -> None:
    target = tmp_path / "t.parquet"
    wibam(api, "tracks", job, "--format", "parquet", "--out", str(target), "--start", "1", "--end", "2")
    found = read_tracks(target)
    assert [len(track) for track in found] == [10, 10]
    wibam(api, "tracks", job, "--out", str(tmp_path / "t.csv"), "--class", "bus", "--min-speed", "0")
    assert (tmp_path / "t.csv").read_text().count("bus") == 50
