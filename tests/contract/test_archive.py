"""A job's files as one zip archive, over real HTTP."""

from __future__ import annotations

import hashlib
import json
import tracemalloc
import zipfile
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.finished import finished_job, tracks
from tests.service import TOKEN, LiveApi
from wibam_core.cli import jobs
from wibam_core.client import WibamClient
from wibam_core.errors import ServiceUnavailable
from wibam_core.formats.archive import Member, zip_blocks
from wibam_core.formats.tracks import read_tracks

app = typer.Typer()
app.add_typer(jobs.app, name="jobs")


def test_holds_what_the_stages_wrote_the_job_and_digests(api: LiveApi, tmp_path: Path) -> None:
    job = finished_job(api)
    with WibamClient(api.url, TOKEN) as client:
        written = client.download_archive(job, tmp_path)
        listed = client.artifacts(job)
    assert written == tmp_path / f"{job}.zip"
    with zipfile.ZipFile(written) as archive:
        assert archive.testzip() is None
        archive.extractall(tmp_path)
    folder = tmp_path / job
    found = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert found == {"job.json", "SHA256SUMS", *(file.id for file in listed)}
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        digest, _, name = line.partition("  ")
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    assert len(read_tracks(folder / "track" / "tracks.parquet")) == len(tracks())
    assert json.loads((folder / "job.json").read_text())["id"] == job


def test_holds_only_what_is_asked_for(api: LiveApi, tmp_path: Path) -> None:
    job = finished_job(api)
    environment = {"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN}
    arguments = ["jobs", "download", job, "--out", str(tmp_path / "a.zip"), "--stage", "track", "--artifact", "tracks"]
    result = CliRunner().invoke(app, arguments, env=environment)
    assert result.exit_code == 0, result.output
    with zipfile.ZipFile(tmp_path / "a.zip") as archive:
        names = archive.namelist()
    assert names[:2] == [f"{job}/job.json", f"{job}/SHA256SUMS"]
    assert all(name.startswith(f"{job}/track/tracks.") for name in names[2:]) and len(names) > 2
    assert api.http.get(f"/v1/jobs/{job}/archive", params={"stage": "frames"}).status_code == 409
    assert api.http.get(f"/v1/jobs/{job}/archive", params={"stages": "track"}).status_code == 422
    assert api.http.get("/v1/jobs/job_0/archive").status_code == 404


def test_is_made_in_the_memory_of_a_few_blocks(tmp_path: Path) -> None:
    large = tmp_path / "large.parquet"
    with large.open("wb") as file:
        file.truncate(64 << 20)
    tracemalloc.start()
    try:
        size = sum(map(len, zip_blocks([Member("a/large.parquet", large), Member("a/b.json", b"{}")])))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert size > 64 << 20
    assert peak < 8 << 20


def test_a_file_that_is_gone_ends_the_download_and_leaves_no_file(api: LiveApi, tmp_path: Path) -> None:
    job = finished_job(api, b"another recording")
    folder = api.services.results.named(api.services.jobs.job(job), "track", "tracks.parquet").path
    folder.unlink()
    with WibamClient(api.url, TOKEN) as client, pytest.raises(ServiceUnavailable, match="broke off"):
        client.download_archive(job, tmp_path)
    assert list(tmp_path.glob("*.zip")) == []
