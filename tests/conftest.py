"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

#: Property tests look at other examples in every run, but always at the same ones where a change is judged. How long an
#: example takes says how busy the machine is.
settings.register_profile("local", deadline=None)
settings.register_profile("ci", derandomize=True, deadline=None)
settings.load_profile("ci" if os.environ.get("CI") else "local")

#: Tests run side by side, one on each core: several threads of each would wait for each other. Told before anything
#: loads a library that computes; the processes that tests start are told, too.
os.environ.setdefault("OMP_NUM_THREADS", "1")

#: Tests talk to this machine alone, whatever proxy the environment names.
for _name in ("http_proxy", "https_proxy", "all_proxy"):
    os.environ.pop(_name, None)
    os.environ.pop(_name.upper(), None)

ROOT = Path(__file__).resolve().parent.parent
#: All tests in these folders are marked `end_to_end`.
_END_TO_END = (ROOT / "tests" / "browser", ROOT / "tests" / "integration")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark whole services and browsers, before `-m` chooses, and put them first: of several processes
    the first begins with them, and those that are done take over what is left."""
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in _END_TO_END):
            item.add_marker(pytest.mark.end_to_end)
    items.sort(key=_how_soon)


def _how_soon(item: pytest.Item) -> int:
    """Those of a module stay together, since they share what they start."""
    if item.get_closest_marker("end_to_end") is None:
        return 2
    return 1 if item.get_closest_marker("slow") is None else 0


@pytest.fixture(scope="session")
def assets() -> Path:
    """Real footage, calibrations and detectors; they are not part of the project."""
    folder = Path(os.environ.get("WIBAM_TEST_ASSETS", ROOT.parent / "shared" / "data"))
    if not (folder / "README.md").is_file():
        pytest.skip(f"the real material is not at {folder}; set WIBAM_TEST_ASSETS")
    return folder
