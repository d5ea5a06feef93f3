"""A camera's recording of several files over HTTP: `wibam upload` sends a folder, a job needs all of it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

from tests.builders import corner_rig, site_of
from tests.service import TOKEN, LiveApi
from wibam_core.cli.upload import send_site
from wibam_core.client import WibamClient
from wibam_core.errors import MissingCamera
from wibam_core.site import Site
from wibam_core.stages.runner import SiteFolder


@pytest.fixture
def client(api: LiveApi) -> Iterator[WibamClient]:
    with WibamClient(api.url, TOKEN) as client:
        yield client


@pytest.fixture
def sent(client: WibamClient, tmp_path: Path) -> str:
    """The id of a site of which cam2 has two files."""
    (tmp_path / "site.json").write_text(site_of(corner_rig(2)).model_dump_json())
    for name in ("cam1.mp4", "cam2/GX010001.MP4", "cam2/GX020001.MP4"):
        path = tmp_path / "recordings" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(name.encode())
    return send_site(client, SiteFolder.load(tmp_path), Console(quiet=True))


def names(client: WibamClient, site: str) -> list[str]:
    return sorted(file.filename for file in client.files(site) if file.camera == "cam2")


def test_a_folder_of_files_arrives_whole_and_the_job_has_all_of_them(
    api: LiveApi, client: WibamClient, sent: str
) -> None:
    assert names(client, sent) == ["GX010001.MP4", "GX020001.MP4"]
    job = api.services.jobs.job(client.create_job(sent).id)
    assert [file.filename for file in job.recordings["cam2"]] == ["GX010001.MP4", "GX020001.MP4"]


def test_a_file_takes_the_place_of_the_one_of_its_name_alone(api: LiveApi, client: WibamClient, sent: str) -> None:
    before = {file.filename: file.sha256 for file in client.files(sent)}
    api.upload(sent, b"anew", camera="cam2", filename="GX020001.MP4")
    after = {file.filename: file.sha256 for file in client.files(sent)}
    assert {name for name in before if before[name] != after[name]} == {"GX020001.MP4"}


def test_a_name_whose_accents_are_kept_apart_is_that_of_the_list(
    api: LiveApi, client: WibamClient, tmp_path: Path
) -> None:
    site = json.loads(site_of(corner_rig(2)).model_dump_json())
    site["cameras"][1]["recordings"] = ["Süd 1.mp4", "Süd 2.mp4"]
    (tmp_path / "site.json").write_text(json.dumps(site))
    for name in ("cam1.mp4", "cam2/Su\u0308d 1.mp4", "cam2/Süd 2.mp4"):
        (tmp_path / "recordings" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "recordings" / name).write_bytes(name.encode())
    sent = send_site(client, SiteFolder.load(tmp_path), Console(quiet=True))
    assert names(client, sent) == ["Süd 1.mp4", "Süd 2.mp4"]
    api.upload(sent, b"anew", camera="cam2", filename="Su\u0308d 2.mp4")
    assert names(client, sent) == ["Süd 1.mp4", "Süd 2.mp4"]
    client.create_job(sent)


def test_a_file_that_the_site_does_not_list_is_refused_by_name(api: LiveApi, sent: str) -> None:
    refused = api.begin(sent, 10, camera="cam2", filename="GX030001.MP4")
    assert refused.status_code == 422
    assert "GX030001.MP4" in refused.json()["detail"]


def test_a_job_without_all_listed_files_is_refused_by_name(api: LiveApi, client: WibamClient, sent: str) -> None:
    [second] = [file for file in client.files(sent) if file.filename == "GX020001.MP4"]
    assert api.http.delete(f"/v1/sites/{sent}/recordings/{second.id}").status_code == 204
    with pytest.raises(MissingCamera, match=r"camera cam2: GX020001\.MP4 was not uploaded"):
        client.create_job(sent)


def test_files_that_a_new_description_does_not_list_are_taken_off(api: LiveApi, client: WibamClient, sent: str) -> None:
    site = Site.model_validate(api.http.get(f"/v1/sites/{sent}").json()["site"])
    cameras = (site.cameras[0], site.cameras[1].model_copy(update={"recordings": ("GX010001.MP4",)}))
    client.replace_site(sent, site.model_copy(update={"cameras": cameras}))
    assert names(client, sent) == ["GX010001.MP4"]
    client.replace_site(sent, site_of(corner_rig(2)))
    assert names(client, sent) == ["GX010001.MP4"]
