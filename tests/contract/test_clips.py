"""Video clips over HTTP and from the command line: asked for, followed, downloaded in parts, deleted."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import httpx
import pytest
import typer
from typer.testing import CliRunner

from tests.clips import clip_job
from tests.finished import finished_job
from tests.service import TOKEN, LiveApi, wait_until
from wibam_core.cli.clip import clip as clip_command
from wibam_core.client import WibamClient
from wibam_core.documents.clips import ClipSpec
from wibam_core.jobs.clips import ClipState
from worker.clips import ClipRunner
from worker.workplace import Workplace

BODY = {"start_ns": 10**9, "end_ns": 2 * 10**9, "width_px": 640}


@pytest.fixture(scope="module")
def job(api: LiveApi) -> str:
    return clip_job(api)


def render(api: LiveApi, clip_id: str) -> None:
    services, settings = api.services, api.services.settings
    ClipRunner(
        Workplace(services.jobs, services.folder, settings.limits, settings.leases, "tests"), services.clips
    ).run(clip_id)


def test_a_clip_from_asking_to_deleting(api: LiveApi, job: str) -> None:
    answer = api.http.post(f"/v1/jobs/{job}/clips", json=BODY)
    assert answer.status_code == 202, answer.text
    asked = answer.json()
    address = answer.headers["location"]
    assert (asked["state"], asked["spec"]["colour"], asked["outdated"]) == ("queued", "class", False)
    early = api.http.get(f"{address}/video")
    assert (early.status_code, early.json()["hint"]) == (409, "Wait until it has been rendered.")
    render(api, asked["id"])
    done = api.http.get(address).json()
    assert (done["state"], done["facts"]["frames"]) == ("succeeded", 10)
    whole = api.http.get(f"{address}/video")
    assert (whole.headers["content-type"], len(whole.content)) == ("video/mp4", done["size_bytes"])
    part = api.http.get(f"{address}/video", headers={"Range": "bytes=4-7"})
    assert (part.status_code, part.content) == (206, b"ftyp")
    assert [one["id"] for one in api.http.get(f"/v1/jobs/{job}/clips").json()] == [asked["id"]]
    assert api.http.delete(address).status_code == 204
    assert api.http.get(f"{address}/video").status_code == 404
    assert not api.services.folder.clip(asked["id"]).exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"end_ns": 10**9}, "end_ns must lie after start_ns"),
        ({"polygon": [[0, 0], [1, 1]]}, "three corners"),
        ({"polygon": [["a", 0], [1, 1], [2, 2]]}, "number"),
        ({"width_px": 10**6}, "3840"),
        ({"codec": "gif"}, "codec"),
        ({"start_ns": 10**30}, "start_ns"),
    ],
)
def test_what_cannot_be_is_refused(api: LiveApi, job: str, change: dict[str, Any], said: str) -> None:
    answer = api.http.post(f"/v1/jobs/{job}/clips", json={**BODY, **change})
    assert answer.status_code == 422
    assert said in answer.text


def test_other_jobs_and_jobs_without_frames_are_refused(api: LiveApi, job: str) -> None:
    asked = api.http.post(f"/v1/jobs/{job}/clips", json=BODY).json()["id"]
    other = finished_job(api)
    assert api.http.get(f"/v1/jobs/{other}/clips/{asked}").status_code == 404
    assert api.http.delete(f"/v1/jobs/{other}/clips/{asked}").status_code == 404
    assert api.http.get(f"/v1/jobs/{job}/clips/..%2f..%2fwibam/video").status_code in (404, 422)
    assert api.http.post(f"/v1/jobs/{other}/clips", json=BODY).status_code == 404, "it has no frames"
    assert api.http.post("/v1/jobs/job_0000000000000000/clips", json=BODY).status_code == 404


def test_a_shared_link_shows_clips_and_makes_none(api: LiveApi, job: str) -> None:
    asked = api.http.post(f"/v1/jobs/{job}/clips", json=BODY).json()["id"]
    link = api.http.post(f"/v1/jobs/{job}/share-link", json={}).json()["url"]
    with httpx.Client(base_url=api.url, follow_redirects=True, timeout=300) as visitor:
        visitor.get(link)
        assert visitor.get(f"/v1/jobs/{job}/clips/{asked}").status_code == 200
        assert visitor.post(f"/v1/jobs/{job}/clips", json=BODY, headers={"X-Wibam-Page": "1"}).status_code == 401


def test_deleting_the_job_deletes_its_clips(api: LiveApi) -> None:
    job = clip_job(api, b"to be deleted")
    clip = api.http.post(f"/v1/jobs/{job}/clips", json=BODY).json()["id"]
    render(api, clip)
    assert api.services.folder.clip(clip).exists()
    assert api.http.delete(f"/v1/jobs/{job}").status_code == 204
    assert not api.services.folder.clip(clip).exists()
    assert clip not in api.services.clips.ids()


def render_next(api: LiveApi, job: str) -> threading.Thread:
    """A worker that renders the next clip of a job that is asked for."""
    known = {clip.id for clip in api.services.clips.clips(job)}

    def fresh() -> list[str]:
        return [one.id for one in api.services.clips.clips(job) if one.id not in known]

    def work() -> None:
        wait_until(lambda: bool(fresh()))
        render(api, fresh()[0])

    thread = threading.Thread(target=work)
    thread.start()
    return thread


def test_the_client_waits_for_a_clip_and_takes_it(api: LiveApi, job: str, tmp_path: Path) -> None:
    with WibamClient(api.url, TOKEN) as client:
        worker = render_next(api, job)
        asked = client.create_clip(job, ClipSpec(**BODY))
        done = client.wait_for_clip(job, asked.id, interval_s=0.05)
        worker.join()
        assert done.state is ClipState.SUCCEEDED
        path = client.download_clip(job, asked.id, tmp_path / "clip.mp4")
        assert path.stat().st_size == done.size_bytes
        client.delete_clip(job, asked.id)
        assert asked.id not in [one.id for one in client.clips(job)]


def test_the_command_writes_the_same_clip_of_a_job(api: LiveApi, job: str, tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(clip_command)
    worker = render_next(api, job)
    told = ["--url", api.url, "--token", TOKEN, "--out", str(tmp_path / "a.mp4"), "--width", "640", "--class", "car"]
    result = CliRunner().invoke(app, [job, "1", "2", *told], env={"COLUMNS": "200"}, catch_exceptions=False)
    worker.join()
    assert "10 frames of 640x" in result.output and "road users: 1" in result.output
    assert (tmp_path / "a.mp4").read_bytes()[4:8] == b"ftyp"
    wrong = CliRunner().invoke(app, [job, "2", "1", *told])
    assert "end_ns must lie after" in str(wrong.exception)
