"""A real API for each module, on SQLite, without workers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.service import LiveApi, live_api, settings_for


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveApi]:
    with live_api(settings_for(tmp_path_factory.mktemp("service"))) as running:
        yield running
