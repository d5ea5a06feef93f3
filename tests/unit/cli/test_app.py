"""The list of commands: quick, since it imports none of them, and right."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest
from typer.testing import CliRunner

from wibam_core.cli.app import COMMANDS, app, load, summary

_SLOW = ("torch", "cv2", "scipy", "matplotlib", "pyarrow", "numpy", "sqlalchemy")


@pytest.mark.parametrize("name", COMMANDS)
def test_its_sentence_in_the_list_is_that_of_the_command(name: str) -> None:
    assert load(name).help is not None
    assert (load(name).help or "").startswith(summary(name).strip())
    assert summary(name).strip().endswith(".")


def test_the_list_of_commands_imports_none_of_them() -> None:
    code = f"""
import sys
sys.argv = ["wibam", "--help"]
from wibam_core.cli import main
try:
    main()
except SystemExit as end:
    print("loaded:", [name for name in {_SLOW!r} if name in sys.modules], end.code)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert all(name in done.stdout for name in COMMANDS)
    assert done.stdout.rstrip().endswith("loaded: [] 0")


def test_the_version_is_that_of_the_package() -> None:
    result = CliRunner().invoke(app, ["--version"])
    assert (result.exit_code, result.output.split()) == (0, ["wibam", version("wibam")])


def test_an_unknown_command_is_named_and_the_nearest_suggested() -> None:
    result = CliRunner().invoke(app, ["detcet"])
    assert result.exit_code == 2
    assert "detcet" in result.output and "detect" in result.output


def test_help_of_one_command_shows_its_options() -> None:
    result = CliRunner().invoke(app, ["simulate", "--help"])
    assert result.exit_code == 0
    assert "--seconds" in result.output
