"""`wibam upload`, `jobs` and `tracks` against a real API."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from tests.builders import AMBIGUOUS, corner_rig, site_of
from tests.finished import finished_job
from tests.service import TOKEN, LiveApi, live_api, settings_for
from wibam_core.cli import jobs, keys
from wibam_core.cli.display import list_table, print_list
from wibam_core.cli.sites import sites
from wibam_core.cli.tracks import tracks
from wibam_core.cli.upload import upload
from wibam_core.client import WibamClient
from wibam_core.errors import InvalidOption, MissingCamera, NotFound, ServiceUnavailable, Unauthorised, UnknownOption
from wibam_core.formats.tracks import read_tracks

runner = CliRunner()
app = typer.Typer()
app.command()(upload)
app.command()(tracks)
app.command()(sites)
app.add_typer(jobs.app, name="jobs")
app.add_typer(keys.app, name="keys")


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    with live_api(settings_for(tmp_path_factory.mktemp("service"))) as running:
        yield running


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


def wibam(api: LiveApi, *arguments: str, columns: int = 200) -> str:
    environment = {"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN, "COLUMNS": str(columns)}
    result = runner.invoke(app, list(arguments), env=environment)
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
    (folder / "network.safetensors").write_bytes(b"weights")
    site = wibam(api, "upload", str(folder)).split()[-1]
    sent = {(item["purpose"], item["camera"]) for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    assets = {("labels", None), ("detector", None), ("network", None)}
    assert sent == {("recording", "cam1"), ("recording", "cam2"), *assets}
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


@pytest.mark.parametrize(
    ("assignment", "kind"),
    [("finetune.stepz=1", UnknownOption), ("finetune.steps=abc", InvalidOption), ("finetune", InvalidOption)],
)
def test_options_are_checked_before_anything_is_sent(
    api: LiveApi, tmp_path: Path, assignment: str, kind: type[UnknownOption]
) -> None:
    before = len(api.http.get("/v1/sites").json())
    with pytest.raises(UnknownOption) as refused:
        wibam(api, "upload", str(site_folder(tmp_path / "site")), "--run", "--set", assignment)
    assert type(refused.value) is kind
    assert len(api.http.get("/v1/sites").json()) == before


def test_an_upload_that_fails_names_the_file_and_how_to_go_on(
    api: LiveApi, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = site_folder(tmp_path / "my site")
    send = WibamClient.upload_recording

    def break_off(self: WibamClient, site: str, camera: str, path: Path, progress: Any) -> None:
        if camera == "cam2":
            raise ServiceUnavailable("no answer")
        send(self, site, camera, path, progress)

    monkeypatch.setattr(WibamClient, "upload_recording", break_off)
    environment = {"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN}
    result = runner.invoke(app, ["upload", str(folder)], env=environment)
    site = result.output.strip()
    assert api.http.get(f"/v1/sites/{site}").status_code == 200, "its id was printed"
    error = result.exception
    assert isinstance(error, ServiceUnavailable)
    assert error.message == "cam2.mp4 was not sent: no answer"
    assert f"wibam upload '{folder}' --site {site}" in error.hint
    monkeypatch.undo()
    before = {item["camera"]: item["id"] for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    assert set(before) == {"cam1"}
    wibam(api, "upload", str(folder), "--site", site)
    after = {item["camera"]: item["id"] for item in api.http.get(f"/v1/sites/{site}/recordings").json()}
    assert set(after) == {"cam1", "cam2"}
    assert after["cam1"] == before["cam1"]


def test_sites_are_listed(api: LiveApi) -> None:
    site = api.site(cameras=2)
    api.upload(site, b"one of two")
    [row] = [line for line in wibam(api, "sites", columns=20).splitlines() if site in line]
    assert row.split() == [site, "2", "1", "crossing"]


def test_ids_are_whole_and_times_have_hours_in_a_narrow_pipe(api: LiveApi, job: str) -> None:
    shown = api.http.get(f"/v1/jobs/{job}").json()
    [row] = [line for line in wibam(api, "jobs", "list", columns=40).splitlines() if job in line]
    day, time = shown["created_at"][:16].split("T")
    assert row.split()[:6] == [job, shown["site_id"], "succeeded", "100%", day, time]


def test_a_job_is_marked_and_found_by_it(api: LiveApi, job: str) -> None:
    assert wibam(api, "jobs", "mark", job, "--name", "[bold]", "--tag", "wet", "--tag", "night").strip() == (
        f"{job}: [bold]; night, wet"
    )
    [row] = [line for line in wibam(api, "jobs", "list", "--tag", "wet", "--tag", "night").splitlines() if job in line]
    assert row.split()[-3:] == ["[bold]", "night,", "wet"]
    assert job not in wibam(api, "jobs", "list", "--tag", "dry")
    assert wibam(api, "jobs", "mark", job, "--name", "", "--no-tags").strip() == f"{job}: no name; no tags"


def test_ids_are_whole_in_a_narrow_terminal() -> None:
    table = list_table("job", "site", others=("says",))
    table.add_row("job_5e4d3c2b1a098765", "site_3f0c9a1be2d44c70", "something that may be broken")
    terminal = Console(file=io.StringIO(), force_terminal=True, width=30, color_system=None)
    print_list(terminal, table)
    output = terminal.file.getvalue()  # type: ignore[attr-defined]
    assert "job_5e4d3c2b1a098765 site_3f0c9a1be2d44c70 " in output
    assert "something that may be broken" not in output


def test_without_a_token_the_hint_says_where_it_is(api: LiveApi) -> None:
    result = runner.invoke(app, ["jobs", "list"], env={"WIBAM_URL": api.url, "WIBAM_TOKEN": ""})
    assert isinstance(result.exception, Unauthorised)
    assert "wibam serve" in result.exception.hint


def test_a_finished_job_is_shown(api: LiveApi, job: str) -> None:
    assert "succeeded, 100% done" in wibam(api, "jobs", "show", job)
    assert "succeeded" in wibam(api, "jobs", "watch", job)
    for command in ("show", "watch"):
        shown = wibam(api, "jobs", command, job)
        assert AMBIGUOUS.message in shown and AMBIGUOUS.hint in shown
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


def test_keys_are_made_listed_and_revoked_and_changes_are_told(api: LiveApi) -> None:
    made = wibam(api, "keys", "create", "the van", "--scope", "read", "--days", "2")
    key_id, secret = made.split()[0], made.splitlines()[1].strip()
    with WibamClient(api.url, secret) as client:
        assert client.sites() == client.sites()
    listed = wibam(api, "keys", "list")
    assert key_id in listed
    assert secret not in listed
    assert "works no more" in wibam(api, "keys", "revoke", key_id)
    with pytest.raises(Unauthorised), WibamClient(api.url, secret) as client:
        client.sites()
    assert "DELETE /v1/keys/" in wibam(api, "keys", "audit")
