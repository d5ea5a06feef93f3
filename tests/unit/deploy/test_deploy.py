"""What compose and the Dockerfile refer to exists, and the settings they pass are the ones that are read."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from wibam_core.adapters.settings import ServiceSettings

ROOT = Path(__file__).resolve().parents[3]
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
EXAMPLE = (ROOT / "deploy" / "service.env.example").read_text()
OURS = ("api", "worker")


def settings_names() -> set[str]:
    settings = ServiceSettings(Path("/data"), "sqlite://", "redis://", "0" * 64)
    return set(settings.to_environment())


def variables(text: str) -> set[str]:
    return set(re.findall(r"\$\{(\w+)", text))


def test_the_services_are_the_expected_ones() -> None:
    assert set(COMPOSE["services"]) == {"api", "worker", "postgres", "redis"}


@pytest.mark.parametrize("name", OURS)
def test_the_build_context_and_dockerfile_exist(name: str) -> None:
    build = COMPOSE["services"][name]["build"]
    assert (ROOT / build["context"] / build["dockerfile"]).is_file()


@pytest.mark.parametrize("name", OURS)
def test_commands_name_modules_that_exist(name: str) -> None:
    command = [str(part) for part in COMPOSE["services"][name]["command"]]
    assert command[:2] == ["python", "-m"]
    assert importlib.util.find_spec(command[2]) is not None
    if "--factory" in command:
        module, _, attribute = command[command.index("--factory") + 1].partition(":")
        assert callable(getattr(importlib.import_module(module), attribute))
    if "--app" in command:
        assert importlib.util.find_spec(command[command.index("--app") + 1]) is not None


@pytest.mark.parametrize("name", OURS)
def test_exactly_the_known_settings_are_passed(name: str) -> None:
    assert set(COMPOSE["services"][name]["environment"]) == settings_names()


def test_every_variable_is_explained_and_every_explained_one_is_used() -> None:
    explained = set(re.findall(r"^(\w+)=", EXAMPLE, re.MULTILINE))
    assert variables((ROOT / "docker-compose.yml").read_text()) == explained


def test_named_volumes_and_networks_are_declared() -> None:
    for service in COMPOSE["services"].values():
        assert set(service["networks"]) <= set(COMPOSE["networks"])
        for volume in service.get("volumes", []):
            assert volume.split(":")[0] in COMPOSE["volumes"]


def test_what_is_waited_for_has_a_health_check() -> None:
    for service in COMPOSE["services"].values():
        assert "healthcheck" in service
        for name, condition in service.get("depends_on", {}).items():
            assert condition["condition"] == "service_healthy"
            assert name in COMPOSE["services"]


def test_the_worker_reaches_nothing_outside() -> None:
    networks = COMPOSE["services"]["worker"]["networks"]
    assert all(COMPOSE["networks"][name]["internal"] for name in networks)


def test_the_queue_asks_for_the_password_that_its_users_send() -> None:
    redis = COMPOSE["services"]["redis"]
    password = redis["command"][redis["command"].index("--requirepass") + 1]
    assert variables(password) == {"REDIS_PASSWORD"}
    assert redis["environment"]["REDISCLI_AUTH"] == password, "the health check has to send it"
    for name in OURS:
        assert COMPOSE["services"][name]["environment"]["WIBAM_BROKER_URL"] == f"redis://:{password}@redis:6379/0"


def test_no_other_process_of_the_worker_shows_its_environment_to_stages() -> None:
    assert COMPOSE["services"]["worker"]["init"] is False


def test_the_dockerfile_copies_what_exists_and_runs_as_nobody_special() -> None:
    dockerfile = (ROOT / "deploy" / "Dockerfile").read_text()
    for sources in re.findall(r"^COPY (.+) \S+$", dockerfile, re.MULTILINE):
        for source in sources.split():
            assert (ROOT / source).exists(), source
    assert re.search(r"^USER (?!root)\w+$", dockerfile, re.MULTILINE)
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert "deploy/*.env" in ignored, "secrets do not belong into the image"
