import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from tests.signal_heads import CYCLE, record, sequence
from wibam_core.cli.signals import signals
from wibam_core.errors import InputError, NoSignalChange
from wibam_core.video.encode import VideoWriter

app = typer.Typer()
app.command()(signals)


def call(*arguments):
    result = CliRunner().invoke(app, [str(a) for a in arguments], env={"COLUMNS": "100"})
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "cam.mp4"
    with VideoWriter(path, 50, 58, 12.5, crf=24) as writer:
        for time_ns, image in record(sequence(CYCLE, 20, 5.0), 20.0, noise=3.0):
            writer.write(image, time_ns)
    return path


def test_prints_time_from_to_and_confidence(video):
    lines = [line.split() for line in call(video, "--region", "19,15,12,28").splitlines() if "│" in line]
    rows = [[cell for cell in line if cell != "│"] for line in lines]
    assert [row[2:4] for row in rows] == [["green", "amber"], ["amber", "red"], ["red", "green"]]
    assert [float(row[0]) for row in rows] == pytest.approx([4.0, 7.0, 17.0], abs=0.05)


def test_json_and_several_regions(video):
    found = json.loads(call(video, "--region", "19,15,12,28", "--region", "18,14,14,30", "--json"))
    assert sorted({c["signal"] for c in found}) == ["1", "2"]
    assert len(found) == 6


@pytest.mark.parametrize("text", ["1,2,3", "a,b,c,d", "1,2,0,4", "nan,1,2,3"])
def test_a_malformed_region_is_refused(video, text):
    with pytest.raises(InputError, match="x,y,width,height"):
        call(video, "--region", text)


def test_no_change_is_an_error(video):
    with pytest.raises(NoSignalChange, match=r"cam\.mp4"):
        call(video, "--region", "0,0,10,14")


@pytest.mark.assets
def test_real_junction_prints_its_two_changes(assets: Path):
    clip = assets / "signals" / "junction_640x480_6fps.mp4"
    found = json.loads(call(clip, "--region", "551,180,18,50", "--json"))
    assert [(c["before"], c["after"]) for c in found] == [("amber", "red"), ("red", "green")]
    assert found[1]["time_s"] == pytest.approx(42.4, abs=0.1)
