"""Workers that end without a word, as processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT
from tests.unit.adapters.world import World
from wibam_core.adapters.job_rows import StageKey
from wibam_core.adapters.presence import Presence, departed

_WORKER = """
import sys, time
from pathlib import Path
from wibam_core.adapters.presence import Presence
with Presence(Path(sys.argv[1])) as presence:
    print(presence.owner, flush=True)
    time.sleep(600)
"""


def worker(folder: Path) -> tuple[subprocess.Popen[str], str]:
    program = [sys.executable, "-c", _WORKER, str(folder)]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stdout is not None
    return process, process.stdout.readline().strip()


class TestPresence:
    def test_a_killed_worker_is_known_to_be_gone_and_one_that_lives_or_is_stopped_is_not(self, tmp_path: Path) -> None:
        lives, _ = worker(tmp_path)
        killed, owner = worker(tmp_path)
        with lives, killed:
            os.kill(lives.pid, signal.SIGSTOP)
            assert departed(tmp_path).owners == set()
            killed.kill()
            killed.wait()
            gone = departed(tmp_path)
            assert gone.owners == {owner}
            gone.forget()
            assert departed(tmp_path).owners == set()
            assert len(list(tmp_path.iterdir())) == 1, "the file of the one that lives"
            lives.kill()

    def test_one_that_leaves_is_not_missed(self, tmp_path: Path) -> None:
        with Presence(tmp_path):
            assert len(list(tmp_path.iterdir())) == 1
        assert list(tmp_path.iterdir()) == []

    def test_nothing_is_said_of_other_hosts_and_of_files_that_are_no_workers(self, tmp_path: Path) -> None:
        (tmp_path / "worker_1").write_text('{"owner": "other:1", "host": "another host"}')
        (tmp_path / "worker_2").write_text("no JSON")
        assert departed(tmp_path).owners == set()
        assert len(list(tmp_path.iterdir())) == 2


class TestLeases:
    def test_of_a_worker_that_is_gone_are_taken_back_before_they_expire(self, world: World) -> None:
        job, other = world.job(), world.job("x")
        lost = world.claim(job, "a", "gone")
        world.claim(other, "a", "there")
        assert world.leases.reap(gone={"gone"}) == [StageKey(job.id, "a")]
        assert not world.leases.heartbeat(lost).held
        assert world.states(other)["a"] == "running"
        assert world.claim(job, "a", "successor").attempt == 2
