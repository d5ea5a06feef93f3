"""Exports: content from artifacts, one file or an archive, and nothing left behind."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.exchange_content import content
from tests.stage_folders import StageFolders
from wibam_core.artifacts import catalogue
from wibam_core.documents.exports import BoxSource
from wibam_core.errors import Conflict, InputError, NotFound
from wibam_core.exchange.base import Part
from wibam_core.exports import ExportSource, offers, open_export
from wibam_core.formats.framestore import FrameStoreWriter
from wibam_core.formats.labels import write_labels
from wibam_core.scene import Vehicles3D
from wibam_core.site import Origin

NETWORK = [Vehicles3D.of(0, np.array([[1.0, 2, 0.8, 4, 2, 1.6, 0]]), camera_id="cam1")]


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Where exports write; empty again when the test is over."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def finished(root: Path) -> ExportSource:
    """A job that went through, with labels and an origin."""
    given = content()
    assert given.site is not None and given.rig is not None
    folders = StageFolders(root / "stages")
    folders.give(catalogue.RIG, given.rig)
    folders.give(catalogue.ANNOTATIONS, list(given.instants or ()))
    folders.give(catalogue.FITS, list(given.boxes_3d or ()))
    folders.give(catalogue.PREDICTIONS_FINETUNED, NETWORK)
    folders.give(catalogue.TRACKS, list(given.tracks or ()))
    folders.give(catalogue.REPORT, "<h1>report</h1>")
    labels = root / "labels.parquet"
    write_labels(labels, given.labels or ())
    site = given.site.model_copy(update={"origin": Origin(latitude_deg=48.0, longitude_deg=11.0)})
    return ExportSource(site, folders.reader, labels)


def test_a_finished_job_has_every_part_but_frames_and_only_what_is_wanted_is_read(tmp_path: Path) -> None:
    source = finished(tmp_path)
    assert source.parts == frozenset(Part) - {Part.FRAMES}
    whole = source.content(frozenset(Part))
    assert whole.parts == source.parts
    assert len(whole.tracks or ()) == 3 and len(whole.instants or ()) == 5 and len(whole.labels or ()) == 5
    assert source.content({Part.TRACKS}).parts == {Part.TRACKS, Part.ORIGIN}


def test_3d_boxes_are_the_fits_or_those_of_the_network(tmp_path: Path) -> None:
    source = finished(tmp_path)
    assert len(source.content({Part.BOXES_3D}).boxes_3d or ()) == 5
    (only,) = source.content({Part.BOXES_3D}, BoxSource.NETWORK).boxes_3d or ()
    assert only.camera_id == "cam1"


def test_frames_leave_in_the_size_of_the_recording(tmp_path: Path) -> None:
    given = content()
    assert given.site is not None
    folders = StageFolders(tmp_path)
    image = np.full((90, 160, 3), (10, 200, 60), np.uint8)
    with FrameStoreWriter(folders.place(catalogue.FRAMES), 90) as writer:
        writer.add("cam1", 0, 7, image)
        writer.close({"cam1": (320, 180)})
    jpeg = ExportSource(given.site, folders.reader).content({Part.FRAMES}).jpeg
    assert jpeg is not None
    decoded = cv2.imdecode(np.frombuffer(jpeg("cam1", 7), np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None and decoded.shape == (180, 320, 3)
    np.testing.assert_allclose(decoded.reshape(-1, 3).mean(axis=0), (10, 200, 60), atol=4)


def test_one_file_comes_as_it_is(tmp_path: Path, scratch: Path) -> None:
    with open_export("ssam", finished(tmp_path)) as opened:
        data = b"".join(opened.blocks)
    assert opened.name == "tracks.trj" and len(data) == opened.size_bytes
    assert data[:2] == b"\0L"


def test_several_files_come_as_an_archive_which_is_equal_every_time(tmp_path: Path, scratch: Path) -> None:
    source = finished(tmp_path)
    with open_export("levelx", source) as opened:
        data = b"".join(opened.blocks)
    assert (opened.name, opened.size_bytes) == ("levelx.zip", None)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.namelist() == ["00_tracks.csv", "00_tracksMeta.csv", "00_recordingMeta.csv"]
        assert archive.testzip() is None
        assert archive.read("00_tracksMeta.csv").count(b"\n") == 4
    with open_export("levelx", source) as again:
        assert b"".join(again.blocks) == data


def test_everything_holds_our_own_files_too(tmp_path: Path, scratch: Path) -> None:
    with open_export("everything", finished(tmp_path)) as opened:
        data = b"".join(opened.blocks)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        assert archive.read("wibam/report/report.html") == b"<h1>report</h1>"
        assert names[-1] == "README.md"
    assert {"geojson/tracks.geojson", "coco/instances.json", "wibam/track/tracks.parquet"} <= set(names)


def test_a_file_that_nobody_takes_to_its_end_leaves_nothing(tmp_path: Path, scratch: Path) -> None:
    for name in ("ssam", "levelx"):
        source = finished(tmp_path / name)
        with open_export(name, source) as opened:
            next(opened.blocks)
        open_export(name, source).close()  # not one block was taken


def test_offers_say_what_is_missing(tmp_path: Path) -> None:
    given = content()
    assert given.site is not None
    folders = StageFolders(tmp_path)
    before = {offer.name: offer for offer in offers(ExportSource(given.site, folders.reader))}
    assert not any(offer.available for offer in before.values())
    assert before["everything"].missing == ("boxes_2d", "boxes_3d", "calibration", "labels", "tracks")
    folders.give(catalogue.TRACKS, list(given.tracks or ()))
    after = {offer.name: offer for offer in offers(ExportSource(given.site, folders.reader))}
    assert {name for name, offer in after.items() if offer.available} == {"everything", "levelx", "ssam"}
    assert after["geojson"].missing == ("origin",)


def test_what_cannot_be_written_is_said_before_anything_is_sent(tmp_path: Path, scratch: Path) -> None:
    given = content()
    assert given.site is not None
    folders = StageFolders(tmp_path / "stages")
    source = ExportSource(given.site, folders.reader)
    with pytest.raises(InputError, match="without tracks"):
        open_export("levelx", source)
    with pytest.raises(NotFound, match="'dbf'"):
        open_export("dbf", source)
    folders.give(catalogue.ANNOTATIONS, [])
    with pytest.raises(InputError, match="nothing to write as OpenTrafficCam"):
        open_export("ottrk", source)


def test_what_another_version_wrote_otherwise_is_said(tmp_path: Path) -> None:
    source = finished(tmp_path)
    split = source.artifacts.local(catalogue.SPLIT)
    split.write_text('{"train": [1, 2]}')
    with pytest.raises(Conflict, match=r"dataset/split\.json was made by another version"):
        open_export("wibam-dataset", source)
