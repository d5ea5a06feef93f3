"""Errors name files as the user called them, and no path of the service's disk."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from tests.unit.adapters.world import World
from wibam_core.adapters.database import Database
from wibam_core.adapters.naming import in_users_words
from wibam_core.errors import StageCrashed, UnreadableVideo
from wibam_core.jobs.records import Purpose, StoredFile

VIDEO = StoredFile("file_e335789000000001", "site_1", Purpose.RECORDING, "north", "GX0042.MP4", "", 1, "0", 0.0)
LABELS = replace(
    VIDEO, id="file_e335789000000002", purpose=Purpose.LABELS, camera_id="", filename="hand.json", suffix=".json"
)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("file_e335789000000001 is an empty file", "GX0042.MP4 (camera north) is an empty file"),
        ("file_e335789000000002.json: label 3 has no class", "hand.json: label 3 has no class"),
        ("from /srv/data/files/file_e335789000000001 failed: x", "from GX0042.MP4 (camera north) failed: x"),
        ("no file file_0000000000000000 there", "no file file_0000000000000000 there"),
        ("cannot write '/srv/data/stages/sync-1/clocks.json': no", "cannot write 'clocks.json': no"),
        ("12 m/s or km/h; see http://a.b/c/d and ~/x/y", "12 m/s or km/h; see http://a.b/c/d and ~/x/y"),
        ("Jobs are listed by /v1/sites and /v1/jobs.", "Jobs are listed by /v1/sites and /v1/jobs."),
    ],
)  # fmt: skip
def test_text_is_rewritten(text: str, shown: str) -> None:
    assert in_users_words(text, [VIDEO, LABELS]) == shown


def test_a_recording_that_is_called_like_its_camera_is_not_explained() -> None:
    assert in_users_words(VIDEO.id, [replace(VIDEO, filename="north.mp4")]) == "north.mp4"
    assert in_users_words(VIDEO.id, [replace(VIDEO, filename="")]) == "the recording of camera north"
    assert in_users_words(VIDEO.id, [replace(VIDEO, filename="C:\\cam\\north.mp4")]) == "north.mp4"


def test_everything_in_an_error_is_rewritten() -> None:
    error = StageCrashed("x", hint=f"look at {VIDEO.id}", log_tail=['File "/srv/app/a.py", line 3'], exit_code=1)
    found = in_users_words(error.to_dict(), [VIDEO])
    assert found["hint"] == "look at GX0042.MP4 (camera north)"
    assert found["details"] == {"log_tail": ['File "a.py", line 3'], "exit_code": 1}


def test_a_failed_job_tells_it_like_that(database: Database) -> None:
    world = World(database)
    job = world.job()
    world.leases.fail(world.claim(job, "a"), UnreadableVideo(f"/srv/data/files/{world.file.id} is no video"))
    failed = world.jobs.job(job.id)
    assert failed.error is not None
    assert failed.error["message"] == "n.mp4 (camera north) is no video"
    assert world.file.id not in json.dumps([dict(event.data) for event in world.jobs.events(job.id)[0]])
