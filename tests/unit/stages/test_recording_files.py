"""Where the files of a camera's recording lie in a site folder."""

import json
import re
import unicodedata
from pathlib import Path

import pytest

from tests.builders import corner_rig, site_of
from wibam_core.artifacts.access import MANIFEST
from wibam_core.errors import MissingCamera, SiteFileError
from wibam_core.stages.graph import STAGES
from wibam_core.stages.recording_files import digest_of, find_recording, unclaimed
from wibam_core.stages.runner import SiteFolder


def folder_with(root: Path, *names: str, **lists: list[str]) -> SiteFolder:
    """A site of cam1 and cam2 with these files below ``recordings/``, and with lists of some cameras' recordings."""
    site = json.loads(site_of(corner_rig(2)).model_dump_json())
    for camera in site["cameras"]:
        camera["recordings"] = lists.get(camera["id"], [])
    root.mkdir(exist_ok=True)
    (root / "site.json").write_text(json.dumps(site))
    for name in names:
        path = root / "recordings" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())
    return SiteFolder.load(root)


def names_of(folder: SiteFolder, camera_id: str) -> list[str]:
    return [file.name for file in folder.recordings[camera_id].files]


def test_a_folder_of_a_camera_holds_all_its_files(tmp_path: Path) -> None:
    folder = folder_with(
        tmp_path, "cam1.mp4", "cam2/GX020001.MP4", "cam2/GX010001.MP4", "cam2/GX010001.THM", "cam2/.DS_Store"
    )
    assert names_of(folder, "cam1") == ["cam1.mp4"]
    assert names_of(folder, "cam2") == ["GX010001.MP4", "GX020001.MP4"]


def test_a_list_chooses_files_beside_each_other_or_in_the_camera_s_folder(tmp_path: Path) -> None:
    folder = folder_with(
        tmp_path, "cam1.mp4", "b.mp4", "cam2/a.mp4", "cam2/other.mp4", cam2=["b.mp4", "a.mp4"], cam1=["cam1.mp4"]
    )
    assert names_of(folder, "cam2") == ["a.mp4", "b.mp4"]


@pytest.mark.parametrize("form", ["NFC", "NFD"])
@pytest.mark.parametrize("said", ["NFC", "NFD"])
def test_a_list_means_a_file_whose_letters_and_accents_are_kept_apart(tmp_path: Path, form: str, said: str) -> None:
    names = ["Straße Süd 1.mp4", "Straße Süd 2.mp4"]
    there, listed = ([unicodedata.normalize(kind, name) for name in names] for kind in (form, said))
    folder = folder_with(tmp_path, "cam1.mp4", f"cam2/{there[0]}", there[1], cam2=listed)
    assert names_of(folder, "cam2") == names
    assert not unclaimed(tmp_path / "recordings", folder.site.cameras)


@pytest.mark.parametrize("first", ["NFC", "NFD"])
def test_of_two_files_that_differ_in_how_accents_are_kept_the_one_named_as_listed_is_taken(
    tmp_path: Path, first: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "S\u00fcd.mp4"
    for form in ("NFC", "NFD"):
        (tmp_path / unicodedata.normalize(form, name)).touch()
    in_order = sorted(tmp_path.iterdir(), key=lambda path: not unicodedata.is_normalized(first, path.name))
    monkeypatch.setattr(Path, "iterdir", lambda _: iter(in_order))
    recording = find_recording(tmp_path, "cam2", [name])
    assert recording is not None and [file.path.name for file in recording.files] == [name]


def test_a_listed_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissingCamera, match=r"b\.mp4, a recording of camera cam2, is not there"):
        folder_with(tmp_path, "cam1.mp4", "cam2/a.mp4", cam2=["b.mp4", "a.mp4"])


def test_a_file_and_a_folder_of_one_camera_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SiteFileError, match=r"several recordings: cam2\.mp4, a\.mp4") as refused:
        folder_with(tmp_path, "cam1.mp4", "cam2.mp4", "cam2/a.mp4")
    assert "recordings/cam2/" in refused.value.hint


@pytest.mark.parametrize("beside", ["cam2/.DS_Store", "cam2/GX010001.THM"])
def test_a_folder_without_recordings_joins_no_files_beside_it(tmp_path: Path, beside: str) -> None:
    with pytest.raises(SiteFileError, match=r"several recordings: cam2\.mkv, cam2\.mp4"):
        folder_with(tmp_path, "cam1.mp4", "cam2.mp4", "cam2.mkv", beside)
    (tmp_path / "recordings" / "cam2.mkv").unlink()
    assert names_of(SiteFolder.load(tmp_path), "cam2") == ["cam2.mp4"]


def test_what_a_camera_writes_beside_its_only_recording_is_passed_over(tmp_path: Path) -> None:
    folder = folder_with(
        tmp_path,
        "cam1.MP4",
        "cam1.SRT",
        "cam1.LRV",
        "cam1.v2.jpg",
        "cam1.en.vtt",
        "cam1.NMEA",
        "cam2.north side.v2.mkv",
    )
    assert (names_of(folder, "cam1"), names_of(folder, "cam2")) == (["cam1.MP4"], ["cam2.north side.v2.mkv"])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("CAM2.mp4", "there is 'CAM2.mp4'"),
        ("cam2 .mp4", "there is 'cam2 .mp4'"),
        ("cam2/DCIM/100GOPRO/GX010001.MP4", "deeper: DCIM/100GOPRO/GX010001.MP4"),
    ],
)
def test_a_recording_where_nobody_looks_is_named(tmp_path: Path, name: str, words: str) -> None:
    with pytest.raises(SiteFileError, match=re.escape(words)) as refused:
        folder_with(tmp_path, "cam1.mp4", name)
    assert "cam2" in refused.value.hint


def test_a_recording_in_other_letters_is_named_before_a_thumbnail(tmp_path: Path) -> None:
    with pytest.raises(SiteFileError, match=r"there is 'CAM2\.mp4'"):
        folder_with(tmp_path, "cam1.mp4", "CAM2.mp4", "cam2/thumb.jpg")


@pytest.mark.parametrize("name", ["cam2.jpg", "cam2/a.jpg", "CAM2.mp4", "cam2/deeper/a.mp4"])
def test_what_lies_in_place_of_a_recording_is_no_matter_where_none_is_needed(tmp_path: Path, name: str) -> None:
    for stage in STAGES.values():
        folder = tmp_path / "given" / stage.name
        folder.mkdir(parents=True)
        for file in (MANIFEST, *(artifact.file for artifact in stage.writes)):
            (folder / file).touch()
    assert not folder_with(tmp_path, name).recordings


@pytest.mark.parametrize("names", [["a.mp4", "a.mp4"], ["../a.mp4"], ["x\\a.mp4"], [""], [".."]])
def test_a_list_holds_plain_names_that_differ(tmp_path: Path, names: list[str]) -> None:
    with pytest.raises(SiteFileError):
        folder_with(tmp_path, "cam1.mp4", cam2=names)


def test_the_digest_knows_names_but_no_order_and_that_of_one_file_is_the_file_s() -> None:
    assert digest_of([("a", "12")]) == "12"
    both = digest_of([("a", "12"), ("b", "34")])
    assert both == digest_of([("b", "34"), ("a", "12")])
    assert both != digest_of([("a", "34"), ("b", "12")])
    assert both != digest_of([("a", "12"), ("c", "34")])


@pytest.mark.parametrize("names", [("cam2/000001.jpg", "cam2/000002.jpg"), ("cam2.png",), ("cam2/a.bmp",)])
def test_pictures_are_called_pictures(tmp_path: Path, names: tuple[str, ...]) -> None:
    with pytest.raises(SiteFileError, match=f"no recording, but pictures: {Path(names[0]).name}") as refused:
        folder_with(tmp_path, "cam1.mp4", *names)
    assert "video file" in refused.value.hint


def test_a_file_needs_no_extension(tmp_path: Path) -> None:
    assert names_of(folder_with(tmp_path, "cam1", "cam2.mp4"), "cam1") == ["cam1"]


def test_what_dji_writes_beside_its_recordings_is_passed_over(tmp_path: Path) -> None:
    folder = folder_with(tmp_path, "cam1.mp4", "cam2/DJI_0001.MP4", "cam2/DJI_0001.LRF", "cam2/DJI_0001.SRT")
    assert names_of(folder, "cam2") == ["DJI_0001.MP4"]


def test_what_no_camera_is_called_is_known_to_be_unused(tmp_path: Path) -> None:
    folder = folder_with(
        tmp_path, "cam1.mp4", "cam2.part.mp4", "cam3.mp4", "north/GX010001.MP4", "cam1.jpg", ".DS_Store", "extra.mp4"
    )
    assert folder.unclaimed == ("cam3.mp4", "extra.mp4", "north")
    listed = folder_with(tmp_path / "listed", "cam1.mp4", "a.mp4", "b.mp4", cam2=["a.mp4", "b.mp4"])
    assert listed.unclaimed == ()
