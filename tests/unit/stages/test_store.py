"""Stage outputs appear whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

from wibam_core.stages.store import StageStore

DIGEST = "0123456789abcdef" * 4


def test_nothing_is_found_before_it_is_published(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    attempt = store.begin("sync", DIGEST)
    (attempt.output / "clocks.json").write_text("{}")
    assert store.find("sync", DIGEST) is None

    folder = store.publish(attempt, {"cameras": 4}, 1.25)

    assert store.find("sync", DIGEST) == folder
    assert (folder / "clocks.json").read_text() == "{}"
    manifest = store.manifest("sync", DIGEST)
    assert manifest["summary"] == {"cameras": 4}
    assert manifest["files"]["clocks.json"]["bytes"] == 2


def test_of_two_that_raced_the_first_stays(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    first, second = store.begin("sync", DIGEST), store.begin("sync", DIGEST)
    for attempt, text in ((first, "first"), (second, "second")):
        (attempt.output / "f").write_text(text)
        folder = store.publish(attempt, {}, 0.0)
    assert (folder / "f").read_text() == "first"
    assert not second.output.exists()


def test_scratch_outlives_an_attempt_but_not_the_stage(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    attempt = store.begin("finetune", DIGEST)
    (attempt.scratch / "checkpoint").write_text("1")
    store.discard(attempt)
    again = store.begin("finetune", DIGEST)
    assert (again.scratch / "checkpoint").read_text() == "1"
    store.publish(again, {}, 0.0)
    assert not again.scratch.exists()


def test_a_removed_stage_runs_again(tmp_path: Path) -> None:
    store = StageStore(tmp_path)
    store.publish(store.begin("sync", DIGEST), {}, 0.0)
    store.remove("sync", DIGEST)
    assert store.find("sync", DIGEST) is None
    store.publish(store.begin("sync", DIGEST), {"n": 2}, 0.0)
    assert json.loads((store.find("sync", DIGEST) / "manifest.json").read_text())["summary"] == {"n": 2}  # type: ignore[operator]
