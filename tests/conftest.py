"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def assets() -> Path:
    """Real footage, calibrations and detectors; they are not part of the project."""
    folder = Path(os.environ.get("WIBAM_TEST_ASSETS", ROOT.parent / "shared" / "data"))
    if not (folder / "README.md").is_file():
        pytest.skip(f"the real material is not at {folder}; set WIBAM_TEST_ASSETS")
    return folder
