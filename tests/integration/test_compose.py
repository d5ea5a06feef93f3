"""The services of docker-compose.yml as processes, by its own commands, settings and health checks.

PostgreSQL is one that answers already; Redis is started by the file's command. Containers, networks and volumes are not
tried: tests/unit/deploy says of them what the file alone can tell.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy
import yaml

from tests.builders import corner_rig, site_of
from tests.conftest import ROOT
from tests.postgres import postgres_database
from tests.receiver import receiver
from tests.recordings import write_recording
from tests.service import TOKEN, wait_until
from wibam_core.adapters.settings import token_digest
from wibam_core.cli.embedded import _redis_program
from wibam_core.client import WibamClient
from wibam_core.errors import ServiceUnavailable
from wibam_core.jobs.states import JobState, StageState

COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
PATIENCE_S = 600.0


def interpolated(text: str, variables: Mapping[str, str]) -> str:
    """``${NAME}``, ``${NAME:-default}`` and ``${NAME:?why}``, as compose has them."""

    def value(found: re.Match[str]) -> str:
        name, default = found[1], found[3]
        given = variables.get(name, "")
        assert given or found[2] != ":?", f"{name} must be set"
        return given or (default if found[2] == ":-" else "")

    return re.sub(r"\$\{(\w+)(?:(:[-?])([^}]*))?\}", value, text)


@dataclass
class Topology:
    """What runs: names of services -> processes. ``url`` is the API's."""

    url: str
    processes: dict[str, subprocess.Popen[bytes]]
    check: Callable[[str], int]
    database_url: str


def a_free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


@pytest.fixture(scope="module")
def topology(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Topology]:
    folder = tmp_path_factory.mktemp("compose")
    with postgres_database() as database_url:
        try:
            redis_server = _redis_program()
        except ServiceUnavailable as error:
            pytest.skip(error.message)
        with contextlib.ExitStack() as stack:
            yield stack.enter_context(started(folder, database_url, redis_server))


@contextlib.contextmanager
def started(folder: Path, database_url: str, redis_server: str) -> Iterator[Topology]:
    ports = {"api": a_free_port(), "redis": a_free_port()}
    variables = {
        "WIBAM_TOKEN_SHA256": token_digest(TOKEN),
        "POSTGRES_PASSWORD": secrets.token_hex(8),
        "REDIS_PASSWORD": secrets.token_hex(8),
        "WIBAM_WEBHOOK_NETWORKS": "127.0.0.0/8",
        "WIBAM_STAGE_MEMORY_GB": "4",
    }
    here = {  # what containers find by their names, this machine has elsewhere
        "postgresql+psycopg://wibam:" + variables["POSTGRES_PASSWORD"] + "@postgres:5432/wibam": database_url,
        "@redis:6379": f"@127.0.0.1:{ports['redis']}",
        "/data": str(folder / "data"),
        "127.0.0.1:8000": f"127.0.0.1:{ports['api']}",
        "0.0.0.0": "127.0.0.1",
    }

    def ours(text: object) -> str:
        found = interpolated(str(text), variables)
        for there, local in here.items():
            found = found.replace(there, local)
        return found

    def environment(name: str) -> dict[str, str]:
        given = {key: ours(value) for key, value in COMPOSE["services"][name].get("environment", {}).items()}
        inherited = {key: os.environ[key] for key in ("PATH", "HOME", "LANG") if key in os.environ}
        return {**inherited, "PYTHONPATH": str(ROOT), **given}

    def command(name: str) -> list[str]:
        parts = [ours(part) for part in COMPOSE["services"][name]["command"]]
        if name == "redis":
            return [redis_server, *parts[1:], "--port", str(ports["redis"]), "--bind", "127.0.0.1"]
        if name == "api":
            parts[parts.index("8000")] = str(ports["api"])
        return [sys.executable if part == "python" else part for part in parts]

    def check(name: str) -> int:
        how = [ours(part) for part in COMPOSE["services"][name]["healthcheck"]["test"]]
        assert how[0] == "CMD", "checks of our own services need no shell"
        program = [sys.executable if part == "python" else part for part in how[1:]]
        done = subprocess.run(
            program, env=environment(name), cwd=folder, capture_output=True, check=False, timeout=PATIENCE_S
        )
        return done.returncode

    processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(name: str) -> None:
        """A service, after those that it waits for."""
        if name in processes or name == "postgres":
            return
        for before in COMPOSE["services"][name].get("depends_on", {}):
            start(before)
        with (folder / f"{name}.log").open("ab") as log:
            processes[name] = subprocess.Popen(
                command(name), env=environment(name), cwd=folder, stdout=log, stderr=log, start_new_session=True
            )

    try:
        for name in COMPOSE["services"]:
            start(name)
        url = f"http://127.0.0.1:{ports['api']}"
        with httpx.Client(base_url=url, trust_env=False, timeout=PATIENCE_S) as http:

            def is_ready() -> bool:
                for name, process in processes.items():
                    assert process.poll() is None, (name, (folder / f"{name}.log").read_text(errors="replace")[-3000:])
                with contextlib.suppress(httpx.TransportError):
                    return http.get("/readyz").status_code == 200
                return False

            wait_until(is_ready)
        yield Topology(url, processes, check, database_url)
    finally:
        for process in reversed(processes.values()):
            process.send_signal(signal.SIGTERM)
        for process in reversed(processes.values()):
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(30)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_every_service_of_the_file_runs_and_a_job_goes_through_them(topology: Topology, tmp_path: Path) -> None:
    assert set(topology.processes) == set(COMPOSE["services"]) - {"postgres"}
    recording = write_recording(tmp_path / "noise.mp4", width_px=640, height_px=360, seconds=3.0)
    with WibamClient(topology.url, TOKEN) as client, receiver() as told:
        site = client.create_site(site_of(corner_rig(2)))
        for camera in ("cam1", "cam2"):
            client.upload_recording(site.id, camera, recording)
        client.create_webhook(told.url, site_id=site.id)
        created = client.create_job(site.id, {"preflight": {"min_overlap_s": 1.0}}, tags=["compose"])
        job = client.wait(created.id, timeout_s=PATIENCE_S)
        assert job.state is JobState.FAILED
        assert job.error is not None and job.error.code == "unknown_clock"
        assert [stage.state for stage in job.stages if stage.name == "preflight"] == [StageState.SUCCEEDED]
        wait_until(lambda: bool(told.got))
        assert b"unknown_clock" in told.got[0].body
    engine = sqlalchemy.create_engine(topology.database_url)
    with engine.connect() as connection:
        assert connection.scalar(sqlalchemy.text("SELECT state FROM jobs")) == "failed"
    engine.dispose()


@pytest.mark.parametrize("name", ["api", "worker"])
def test_its_health_check_finds_it_well(topology: Topology, name: str) -> None:
    assert topology.check(name) == 0
