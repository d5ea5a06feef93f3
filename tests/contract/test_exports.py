"""Exports over real HTTP, by the client and by the command line; a format that is added is there at once."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.finished import finished_job, tracks
from tests.service import TOKEN, LiveApi, wait_until
from wibam_core.cli.export import export
from wibam_core.client import WibamClient
from wibam_core.documents.exports import BoxSource
from wibam_core.errors import InputError, NotFound
from wibam_core.exchange import registry
from wibam_core.exchange.base import Content, Part, require_parts
from wibam_core.exchange.levelx import LevelX

app = typer.Typer()
app.command()(export)


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return finished_job(api)


@pytest.fixture
def client(api: LiveApi) -> Iterator[WibamClient]:
    with WibamClient(api.url, TOKEN) as connected:
        yield connected


class Tiny:
    """A format that somebody adds: how many tracks there are."""

    name, title, loses = "tiny", "Tiny", "All but the number of tracks."
    needs = writes = frozenset({Part.TRACKS})

    def write(self, content: Content, folder: Path) -> list[Path]:
        require_parts(self, content)
        path = folder / "tiny.txt"
        path.write_text(f"{len(content.tracks or ())}\n")
        return [path]


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry._BY_NAME, "tiny", Tiny())


def wibam_export(api: LiveApi, *arguments: str) -> str:
    environment = {"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN, "COLUMNS": "300"}
    result = CliRunner().invoke(app, list(arguments), env=environment)
    if result.exception is not None:
        raise result.exception
    return result.output


def test_the_list_names_all_formats_and_what_is_missing(client: WibamClient, job: str) -> None:
    found = {offer.name: offer for offer in client.exports(job)}
    assert list(found) == list(registry.FORMATS)
    assert found["ssam"].available and found["ssam"].missing == ()
    assert not found["geojson"].available and found["geojson"].missing == ("origin",)
    assert found["levelx"].loses == LevelX.loses


def test_one_file_is_sent_under_its_name_with_its_size(api: LiveApi, job: str) -> None:
    response = api.http.get(f"/v1/jobs/{job}/exports/ssam")
    assert response.status_code == 200
    assert response.headers["content-disposition"] == f'attachment; filename="{job}-tracks.trj"'
    assert int(response.headers["content-length"]) == len(response.content) > 1000


def test_several_files_are_sent_as_an_archive(api: LiveApi, job: str) -> None:
    response = api.http.get(f"/v1/jobs/{job}/exports/levelx")
    assert response.headers["content-type"] == "application/zip"
    assert response.headers["content-disposition"] == f'attachment; filename="{job}-levelx.zip"'
    with zipfile.ZipFile(io.BytesIO(response.content)) as archive:
        assert archive.testzip() is None
        assert len(archive.read("00_tracks.csv").splitlines()) == 1 + sum(len(track) for track in tracks())


def test_the_client_puts_it_into_a_folder_under_the_name_that_the_service_gives(
    client: WibamClient, job: str, tmp_path: Path
) -> None:
    assert client.download_export(job, "levelx", tmp_path) == tmp_path / f"{job}-levelx.zip"
    assert client.download_export(job, "ssam", tmp_path / "my.trj") == tmp_path / "my.trj"
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"{job}-levelx.zip", "my.trj"]


def test_what_is_missing_and_what_there_is_not_are_problems(api: LiveApi, client: WibamClient, job: str) -> None:
    response = api.http.get(f"/v1/jobs/{job}/exports/coco")
    assert response.status_code == 422
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["detail"] == "COCO object detection cannot be written without 2D boxes"
    with pytest.raises(NotFound, match="no exchange format 'dbf'"):
        client.download_export(job, "dbf", Path())
    with pytest.raises(InputError, match="without 3D boxes"):
        client.download_export(job, "nuscenes-results", Path(), BoxSource.NETWORK)
    assert api.http.get(f"/v1/jobs/{job}/exports/ssam", params={"boxes": "guesses"}).status_code == 422
    assert api.http.get(f"/v1/jobs/{job}/exports/ssam", params={"box": "fits"}).status_code == 422
    assert api.http.get("/v1/jobs/job_0000000000000000/exports").status_code == 404


class Large(Tiny):
    """More than a socket holds."""

    name = "large"

    def write(self, content: Content, folder: Path) -> list[Path]:
        path = folder / "large.bin"
        path.write_bytes(bytes(32 << 20))
        return [path]


def test_nothing_is_left_behind_by_a_reader_who_stays_and_one_who_goes(
    api: LiveApi, job: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(registry._BY_NAME, "large", Large())
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with api.http.stream("GET", f"/v1/jobs/{job}/exports/large") as response:
        next(response.iter_bytes(1024))
        assert len(list(tmp_path.iterdir())) == 1
    wait_until(lambda: list(tmp_path.iterdir()) == [])
    assert len(api.http.get(f"/v1/jobs/{job}/exports/large").content) == 32 << 20
    wait_until(lambda: list(tmp_path.iterdir()) == [])


def test_openapi_names_the_formats(api: LiveApi) -> None:
    operation = api.http.get("/openapi.json").json()["paths"]["/v1/jobs/{job_id}/exports/{format}"]["get"]
    (parameter,) = [p for p in operation["parameters"] if p["name"] == "format"]
    assert parameter["schema"]["enum"] == list(registry.FORMATS)
    assert "application/zip" in operation["responses"]["200"]["content"]


def test_the_command_lists_and_writes(api: LiveApi, job: str, tmp_path: Path) -> None:
    listed = wibam_export(api, job)
    assert "geojson" in listed and "origin" in listed and LevelX.loses in listed
    assert str(tmp_path / f"{job}-tracks.trj") in wibam_export(api, job, "ssam", "--out", str(tmp_path))
    assert (tmp_path / f"{job}-tracks.trj").read_bytes()[:2] == b"\0L"


@pytest.mark.usefixtures("tiny")
def test_a_format_that_is_added_is_listed_sent_and_written_without_any_other_change(
    api: LiveApi, client: WibamClient, job: str, tmp_path: Path
) -> None:
    assert "tiny" in {offer.name for offer in client.exports(job)}
    assert api.http.get(f"/v1/jobs/{job}/exports/tiny").text == "2\n"
    wibam_export(api, job, "tiny", "--out", str(tmp_path / "n.txt"))
    assert (tmp_path / "n.txt").read_text() == "2\n"
    assert "All but the number of tracks." in wibam_export(api, job)
