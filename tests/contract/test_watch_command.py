"""`wibam watch` beside a real API: a folder of files and a camera's stream, run after run. No stage runs."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.contract.test_models import made
from tests.finished import publish
from tests.recordings import write_recording
from tests.rtsp_server import Camera, pictures_of, rtsp_server
from tests.service import TOKEN, LiveApi, wait_until
from wibam_core.adapters.stream_recorder import RECORDED
from wibam_core.adapters.watched_folder import alone_in
from wibam_core.cli.watch import watch
from wibam_core.errors import InputError, Locked
from wibam_core.models.weights import bundled

app = typer.Typer()
app.command()(watch)


@pytest.fixture(scope="module")
def model(api: LiveApi) -> dict:
    """The promoted network of a site with one camera."""
    site = api.site(cameras=1)
    api.upload(site, b"not looked at", "cam1")
    job = api.http.post(f"/v1/sites/{site}/jobs", json={}).json()["id"]
    publish(api, job, made(weights=bundled("mono_small.safetensors").read_bytes()))
    (found,) = api.http.get("/v1/models", params={"job": job}).json()
    api.http.patch(f"/v1/models/{found['id']}", json={"state": "promoted"})
    return dict(found)


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def runs(api: LiveApi, model: dict) -> list[dict]:
    """The oldest first."""
    return list(reversed(api.http.get(f"/v1/models/{model['id']}/runs").json()))


@contextmanager
def stages_end(
    api: LiveApi, model: dict, then: Callable[[], None] = lambda: None, cancelled: tuple[str, ...] = ()
) -> Iterator[None]:
    """All runs end well, soon after they were made, but those of ``cancelled`` names; ``then`` is called each time."""
    stop = threading.Event()

    def work() -> None:
        try:
            end_all()
        except BaseException:
            os.kill(os.getpid(), signal.SIGTERM)  # else the watch waits for ever for a run that does not end
            raise

    def end_all() -> None:
        dealt_with = {run["id"] for run in runs(api, model)}
        while not stop.wait(0.5):
            for run in runs(api, model):
                if run["id"] not in dealt_with:
                    dealt_with.add(run["id"])
                    if run["name"] in cancelled:
                        assert api.http.post(f"/v1/jobs/{run['id']}/cancel").status_code == 202
                    else:
                        publish(api, run["id"], made())
                    then()

    with ThreadPoolExecutor(1) as pool:
        ending = pool.submit(work)
        try:
            yield
        finally:
            stop.set()
            ending.result()


def wibam_watch(api: LiveApi, *arguments: str) -> str:
    environment = {"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN, "COLUMNS": "200"}
    result = CliRunner().invoke(app, list(arguments), env=environment)
    if result.exception is not None:
        raise result.exception
    return result.output


def test_files_are_run_one_after_the_other_and_once(api: LiveApi, model: dict, tmp_path: Path) -> None:
    begun = len(runs(api, model))
    (tmp_path / "cam1").mkdir()
    for name in ("2026-07-01_08-00-00.mp4", "2026-07-01_08-10-00.mp4"):
        (tmp_path / "cam1" / name).write_bytes(name.encode())
    arguments = (str(tmp_path), "--site", model["site_id"], "--quiet", "0", "--once", "--utc-offset", "2")
    with stages_end(api, model):
        wibam_watch(api, *arguments)
        wibam_watch(api, *arguments)
        first, second = runs(api, model)[begun:]
        assert second["continues"] == first["id"]
        # what was sent and run, but not noted since the program was ended, is found again
        noted = tmp_path / ".wibam-watched.json"
        kept = json.loads(noted.read_text())
        assert kept.pop("cam1/2026-07-01_08-10-00.mp4")["started"] == "2026-07-01T06:10:00.000+00:00"
        noted.write_text(json.dumps(kept))
        wibam_watch(api, *arguments)
    assert len(runs(api, model)) == begun + 2
    assert set(json.loads(noted.read_text())) == {"cam1/2026-07-01_08-00-00.mp4", "cam1/2026-07-01_08-10-00.mp4"}
    assert len(list((tmp_path / "cam1").iterdir())) == 2


def test_runs_that_were_cancelled_or_deleted_hold_nothing_up(api: LiveApi, model: dict, tmp_path: Path) -> None:
    begun, names = len(runs(api, model)), [f"cam1/2026-07-02_08-{tens}0-00.mp4" for tens in range(4)]
    (tmp_path / "cam1").mkdir()
    arguments = (str(tmp_path), "--site", model["site_id"], "--quiet", "0", "--once")

    def put(*some: str) -> None:
        for name in some:
            (tmp_path / name).write_bytes(name.encode())

    with stages_end(api, model, cancelled=(names[1],)):
        put(*names[:3])
        wibam_watch(api, *arguments)
        first, _, third = runs(api, model)[begun:]
        noted = json.loads((tmp_path / ".wibam-watched.json").read_text())
        assert [noted[name].get("failed") for name in names[:3]] == [None, "it was cancelled", None]
        assert third["continues"] == first["id"]
        assert api.http.delete(f"/v1/jobs/{third['id']}").status_code == 204
        put(names[3])
        said = wibam_watch(api, *arguments)
    assert f"nothing is left of run {third['id']}" in said
    assert runs(api, model)[-1]["name"] == names[3]
    assert runs(api, model)[-1]["continues"] is None


def test_no_recording_goes_before_it_is_noted(api: LiveApi, model: dict, tmp_path: Path) -> None:
    file = tmp_path / "cam1" / "wibam-recorded" / "2026-07-03_08-00-00.000Z.mkv"
    file.parent.mkdir(parents=True)
    file.write_bytes(b"recorded here")
    blocked = tmp_path / ".wibam-watched.json.tmp"
    blocked.mkdir()
    arguments = (str(tmp_path), "--site", model["site_id"], "--once")
    with stages_end(api, model):
        with pytest.raises(InputError, match="cannot be used"):
            wibam_watch(api, *arguments)
        assert file.exists()
        blocked.rmdir()
        wibam_watch(api, *arguments)
    assert not file.exists()
    # a program that was ended between note and removal
    file.write_bytes(b"recorded here")
    wibam_watch(api, *arguments)
    assert not file.exists()


def test_a_folder_is_watched_by_one_program_alone(api: LiveApi, model: dict, tmp_path: Path) -> None:
    with alone_in(tmp_path), pytest.raises(Locked, match="another `wibam watch`"):
        wibam_watch(api, str(tmp_path), "--site", model["site_id"], "--once")


def test_a_stream_is_recorded_run_and_removed(api: LiveApi, model: dict, tmp_path: Path) -> None:
    begun, ended = len(runs(api, model)), []

    def one_more() -> None:
        ended.append(1)
        if len(ended) == 3:
            os.kill(os.getpid(), signal.SIGTERM)

    folder, login = tmp_path / "folder", ("admin", "s3cret")
    pictures = pictures_of(write_recording(tmp_path / "live.mp4"))
    with rtsp_server(Camera(pictures, login=login)) as camera, stages_end(api, model, one_more):
        (tmp_path / "address").write_text(camera.url("admin:s3cret@") + "\n")
        said = wibam_watch(
            api, str(folder), "--site", model["site_id"], "--quiet", "3", "--chunk-minutes", "0.1",
            "--stream", f"cam1=@{tmp_path / 'address'}",
        )  # fmt: skip
        wait_until(lambda: len(ended) >= 3)
    assert "is being recorded" in said
    assert "stopping" in said
    assert "s3cret" not in said
    made_runs = runs(api, model)[begun:]
    assert [b["continues"] == a["id"] for a, b in pairwise(made_runs)] == [True] * (len(made_runs) - 1)
    noted = json.loads((folder / ".wibam-watched.json").read_text())
    assert {one["run"] for one in noted.values()} <= {run["id"] for run in made_runs}
    assert len(noted) == 1, "what the next run needs, and no more"
    files = api.http.get(f"/v1/sites/{model['site_id']}/footage", params={"camera": "cam1"}).json()
    sent = [file for file in files if f"cam1/wibam-recorded/{file['filename']}" in {run["name"] for run in made_runs}]
    assert len(sent) == len(made_runs) >= 2
    for file in sent:  # the name and the time that the service knows are one
        assert file["started_at"][:23].replace(":", "-").replace("T", "_") == file["filename"][:23]
    left = list((folder / "cam1" / RECORDED).iterdir())
    assert not {path.name for path in left} & {Path(name).name for name in noted}
    assert not any(path.name.startswith(".") for path in left)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--stream", "cam9=rtsp://127.0.0.1:9/x"), "no camera 'cam9'"),
        (("--stream", "rtsp://a:s3cret@127.0.0.1/x?a=b"), "whose a stream is"),
        (("--stream", "cam1=http://a:s3cret@127.0.0.1/x"), "not of the form"),
        (("--stream", "cam1=@/no/such/file"), "cannot be read"),
        (("--stream", "cam1=rtsp://127.0.0.1:9/x", "--once"), "no end to wait for"),
        (("--stream", "cam1=rtsp://127.0.0.1:9/x", "--stream", "cam1=rtsp://127.0.0.1:9/y"), "two streams"),
    ],
)
def test_streams_that_cannot_be(
    api: LiveApi, model: dict, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    with pytest.raises(InputError, match=said) as refused:
        wibam_watch(api, str(tmp_path), "--site", model["site_id"], *arguments)
    assert "s3cret" not in str(refused.value.to_dict())
