"""Stage outputs appear whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.builders import corner_rig, site_of
from wibam_core.artifacts.access import MANIFEST
from wibam_core.config import PipelineConfig
from wibam_core.stages import runner
from wibam_core.stages.store import StageStore
from wibam_core.video.recording import Recording

HASH = "0123456789abcdef" * 4


def test_nothing_is_found_before_it_is_published(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    attempt = store.begin("sync", HASH)
    (attempt.output / "clocks.json").write_text("{}")
    assert store.find("sync", HASH) is None

    folder = store.publish(attempt, {"cameras": 4}, 1.25)

    assert store.find("sync", HASH) == folder
    assert (folder / "clocks.json").read_text() == "{}"
    manifest = store.manifest("sync", HASH)
    assert manifest.summary == {"cameras": 4}
    assert manifest.files["clocks.json"].bytes == 2


def test_of_two_that_raced_the_first_stays(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    first, second = store.begin("sync", HASH), store.begin("sync", HASH)
    for attempt, text in ((first, "first"), (second, "second")):
        (attempt.output / "f").write_text(text)
        folder = store.publish(attempt, {}, 0.0)
    assert (folder / "f").read_text() == "first"
    assert not second.output.exists()


def test_scratch_outlives_an_attempt_but_not_the_stage(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    attempt = store.begin("finetune", HASH)
    (attempt.scratch / "checkpoint").write_text("1")
    store.discard(attempt)
    again = store.begin("finetune", HASH)
    assert (again.scratch / "checkpoint").read_text() == "1"
    store.publish(again, {}, 0.0)
    assert not again.scratch.exists()


def test_a_removed_stage_runs_again(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    store.publish(store.begin("sync", HASH), {}, 0.0)
    store.remove("sync", HASH)
    assert store.find("sync", HASH) is None
    store.publish(store.begin("sync", HASH), {"n": 2}, 0.0)
    assert json.loads((store.find("sync", HASH) / "manifest.json").read_text())["summary"] == {"n": 2}  # type: ignore[operator]


class Killed(BaseException):
    """Stands for SIGKILL: nothing handles it."""


def test_a_stage_whose_removal_was_killed_runs_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def kill(path: Path, **_: object) -> None:
        if path.exists():
            raise Killed

    store = StageStore(tmp_path)
    attempt = store.begin("sync", HASH)
    (attempt.output / "clocks.json").write_text("{}")
    store.publish(attempt, {}, 0.0)
    with monkeypatch.context() as patched:
        patched.setattr(shutil, "rmtree", kill)
        with pytest.raises(Killed):
            store.remove("sync", HASH)
    assert store.find("sync", HASH) is None
    store.publish(store.begin("sync", HASH), {"n": 2}, 0.0)
    assert store.manifest("sync", HASH).summary == {"n": 2}
    store.sweep(set)
    assert list((tmp_path / ".partial").iterdir()) == []


def test_what_version_0_1_published_is_read(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    folder = tmp_path / f"sync-{HASH[:32]}"
    folder.mkdir()
    manifest = {"stage": "sync", "digest": HASH, "seconds": 1.5, "summary": {}, "files": {}}
    (folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    assert store.manifest("sync", HASH).hash == HASH


def test_a_folder_without_a_manifest_is_in_nobodys_way(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    folder = store.publish(store.begin("sync", HASH), {}, 0.0)
    (folder / "manifest.json").unlink()
    (folder / "rest").touch()
    assert store.publish(store.begin("sync", HASH), {"n": 2}, 0.0) == folder
    assert store.manifest("sync", HASH).summary == {"n": 2}
    assert not (folder / "rest").exists()


def test_everything_is_on_disk_before_it_is_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = StageStore(tmp_path)
    attempt = store.begin("frames", HASH)
    (attempt.output / "more").mkdir()
    (attempt.output / "more" / "cam1.jpegs").write_bytes(b"x" * 100)
    synced: set[int] = set()
    sync = os.fsync

    def note(descriptor: int) -> None:
        sync(descriptor)
        synced.add(os.fstat(descriptor).st_ino)

    monkeypatch.setattr(os, "fsync", note)
    store.seal(attempt, {}, 0.0)
    names = {".", "more", "more/cam1.jpegs", "manifest.json"}
    assert {(attempt.output / name).stat().st_ino for name in names} <= synced
    store.reveal(attempt)
    assert tmp_path.stat().st_ino in synced


def test_what_a_killed_attempt_used_is_swept_away(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    killed = store.begin("sync", HASH)
    with store.temporary(killed) as folder:
        store.sweep(lambda: {HASH})
        assert Path(folder).is_dir()
        store.sweep(set)
        assert not Path(folder).exists()


def test_addresses_are_those_of_outputs_and_scratch(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    assert store.addresses() == set()
    store.publish(store.begin("sync", HASH), {}, 0.0)
    store.begin("finetune", HASH)
    (tmp_path / "my-notes").mkdir()
    assert store.addresses() == {("sync", HASH[:32]), ("finetune", HASH[:32])}
    for address in store.addresses():
        store.remove(*address)
    assert store.addresses() == set()


_HOLDS_ITS_TURN = """
import sys
import time
from pathlib import Path
from wibam_core.stages.store import StageStore

with StageStore(Path(sys.argv[1])).turn(sys.argv[2], lambda: None):
    print("in", flush=True)
    sys.stdin.read()
    time.sleep(0.3)
    (Path(sys.argv[1]) / "left").touch()
"""


def test_processes_that_make_the_same_stage_take_turns(tmp_path: Path) -> None:
    """They share its scratch folder: a second would train on images that the first had not written yet."""
    other = "b" * 64
    command = [sys.executable, "-c", _HOLDS_ITS_TURN, str(tmp_path), HASH]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        assert process.stdout.readline() == "in\n"
        with StageStore(tmp_path).turn(other, lambda: pytest.fail("another stage is nobody's turn")):
            pass
        waited = []

        def waiting() -> None:
            waited.append(process.poll())
            process.stdin.close()  # the other's turn ends only now

        with StageStore(tmp_path).turn(HASH, waiting):
            assert waited == [None] and (tmp_path / "left").exists()
    with StageStore(tmp_path).turn(HASH, lambda: pytest.fail("nobody is there any more")):
        pass


class SlowStore(StageStore):
    """Somebody else makes the stage while one waits for one's turn."""

    @contextmanager
    def turn(self, hash: str, waiting: Callable[[], None]) -> Iterator[None]:
        waiting()
        attempt = self.begin("preflight", hash)
        self.publish(attempt, {"made": "elsewhere"}, 1.0)
        yield


def test_what_another_process_made_meanwhile_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "run_stage", lambda *_: pytest.fail("it is there"))
    rig = corner_rig()
    for camera_id in rig:
        (tmp_path / camera_id).write_bytes(b"video")
    folder = runner.SiteFolder(site_of(rig), {camera_id: Recording.at(tmp_path / camera_id) for camera_id in rig}, {})
    told: list[runner.StageUpdate] = []
    store = SlowStore(tmp_path / "outputs")
    result = runner.run_pipeline(folder, store, PipelineConfig(), told.append, until="preflight")
    assert result.summaries == {"preflight": {"made": "elsewhere"}}
    assert [update.state for update in told] == ["running", "reused"] and "waiting" in told[0].message


def test_an_attempt_is_told_of_earlier_outputs_that_hold_the_same_of_a_frame(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    of = {number: f"{number}" * 64 for number in range(5)}
    for number, frame_hash in ((0, "same"), (1, "other"), (2, "same"), (3, None)):
        folder = store.publish(store.begin("frames", of[number], frame_hash), {}, 0.0)
        os.utime(folder / MANIFEST, (number, number))
    store.begin("frames", of[4], "same")  # not published
    attempt = store.begin("frames", of[4], "same")
    assert attempt.earlier == (store.find("frames", of[2]), store.find("frames", of[0]))  # the newest first
    assert store.begin("detect", of[4], "same").earlier == ()
    assert store.begin("frames", of[4]).earlier == ()
    assert store.addresses_with("frames", "same") == {("frames", of[0][:32]), ("frames", of[2][:32])}
    store.remove("frames", of[2])
    (folder / MANIFEST).write_text("{")
    assert store.begin("frames", of[4], "same").earlier == (store.find("frames", of[0]),)
