"""`wibam simulate`: what it refuses before it renders anything."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from wibam_core.cli import main
from wibam_core.cli.simulate import _option_name, simulate
from wibam_core.errors import Conflict, InvalidOption
from wibam_core.site import Site
from wibam_core.synthetic.options import SimulationOptions

app = typer.Typer()
app.command()(simulate)
QUICK = ["--seconds", "1", "--fps", "5", "--cameras", "2", "--width", "320", "--height", "180", "--label-rate", "5"]


def run(folder: Path, *options: str) -> str:
    result = CliRunner().invoke(app, [str(folder), *options])
    if result.exception is not None:
        raise result.exception
    return result.output


@pytest.mark.parametrize("name", ["site.json", "recordings/cam1.mov"])
def test_what_a_folder_holds_is_overwritten_only_by_force(tmp_path: Path, name: str) -> None:
    mine = tmp_path / name
    mine.parent.mkdir(exist_ok=True)
    mine.write_text("mine")
    with pytest.raises(Conflict, match="already") as refused:
        run(tmp_path, *QUICK)
    assert "--force" in refused.value.hint
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [mine]
    assert mine.read_text() == "mine"


def test_by_force_a_site_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "site.json").write_text("mine")
    run(tmp_path, *QUICK, "--force")
    assert Site.load(tmp_path / "site.json").camera_ids == ("cam1", "cam2")


def test_a_wrong_value_is_refused_under_the_name_that_was_typed(tmp_path: Path) -> None:
    with pytest.raises(InvalidOption, match=r"^--cycle: ") as refused:
        run(tmp_path / "site", "--cycle", "0")
    assert refused.value.code == "invalid_option"
    assert not (tmp_path / "site").exists()


def test_the_command_line_tells_it_in_two_whole_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / ("long name " * 12).strip()
    folder.mkdir()
    (folder / "site.json").write_text("mine")
    monkeypatch.setattr("sys.argv", ["wibam", "simulate", str(folder)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    message, hint = capsys.readouterr().err.splitlines()
    assert message == f"{folder} holds a site already (conflict)"
    assert "--force" in hint


@pytest.mark.parametrize("field", list(SimulationOptions.model_fields))
def test_every_field_is_named_as_its_option(field: str) -> None:
    names = {"--" + name.replace("_", "-") for name in simulate.__annotations__}
    assert _option_name(field) in names
