"""`wibam demo` removes what a demo wrote, and nothing else. The demo itself is what `make demo` runs."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from wibam_core.cli import demo as module
from wibam_core.cli.embedded import exclusive
from wibam_core.errors import Conflict

app = typer.Typer()
app.command()(module.demo)


class _Begun(Exception):
    """The folder is made; the demo would begin."""


@pytest.fixture(autouse=True)
def no_service(monkeypatch: pytest.MonkeyPatch) -> None:
    def begin(data: Path) -> None:
        raise _Begun

    monkeypatch.setattr(module, "EmbeddedService", begin)


def demo(out: Path) -> None:
    result = CliRunner().invoke(app, ["--out", str(out)])
    assert result.exception is not None
    raise result.exception


def earlier_demo(out: Path) -> Path:
    with pytest.raises(_Begun):
        demo(out)
    for name in ("site/site.json", "data/wibam.db", "data/files/file_1", "report.html", "summary.json", "mine.txt"):
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).write_text("x")
    return out


@pytest.mark.parametrize("name", ["thesis.tex", "site.json", ".git"])
def test_a_folder_that_holds_anything_else_is_left_alone(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("precious")
    with pytest.raises(Conflict, match="not empty"):
        demo(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    with pytest.raises(Conflict, match="not a folder"):
        demo(tmp_path / name)


def test_an_earlier_demo_is_replaced_and_what_it_did_not_write_stays(tmp_path: Path) -> None:
    out = earlier_demo(tmp_path / "demo")
    with pytest.raises(_Begun):
        demo(out)
    left = {str(path.relative_to(out)) for path in out.rglob("*")}
    assert left == {".wibam-demo", "data", "data/serve.lock", "mine.txt"}


def test_a_demo_that_is_still_running_is_left_alone(tmp_path: Path) -> None:
    out = earlier_demo(tmp_path / "demo")
    with exclusive(out / "data"), pytest.raises(Conflict, match="another service"):
        demo(out)
    assert (out / "data" / "files" / "file_1").exists()
    assert (out / "report.html").exists()


def test_a_link_is_removed_not_what_it_leads_to(tmp_path: Path) -> None:
    out = earlier_demo(tmp_path / "demo")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "kept").write_text("x")
    (out / "site" / "site.json").unlink()
    (out / "site").rmdir()
    (out / "site").symlink_to(elsewhere)
    with pytest.raises(_Begun):
        demo(out)
    assert (elsewhere / "kept").exists()
    assert not (out / "site").is_symlink()
