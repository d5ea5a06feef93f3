"""The embedded service for real: its own processes, Redis, SQLite, HTTP."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from wibam_core.cli.embedded import EmbeddedService
from wibam_core.client import WibamClient


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmbeddedService]:
    with EmbeddedService(tmp_path_factory.mktemp("service") / "data") as running:
        yield running


@pytest.fixture
def client(service: EmbeddedService) -> Iterator[WibamClient]:
    with WibamClient(service.url, service.token) as connected:
        yield connected
