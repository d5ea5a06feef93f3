"""Two networks of two jobs compared over real HTTP, by a confined process, on the instants that both have held out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from tests.builders import site_of
from tests.finished import METRICS, publish, tracks
from tests.labelled_job import TIMES_NS
from tests.service import TOKEN, LiveApi
from tests.site_dataset import tiny_rig, tiny_site
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.cli import models
from wibam_core.documents.split import Split
from wibam_core.models.weights import bundled
from wibam_core.scene import Vehicles3D

app = typer.Typer()
app.add_typer(models.app, name="models")
WEIGHTS = bundled("mono_small.safetensors").read_bytes()


def made_job(api: LiveApi, site: str, error_m: float, test: tuple[int, ...], steps: int) -> dict[str, Any]:
    """A finished job whose network errs by so much along X; returns the network."""
    rig = tiny_rig()

    def write(stage: str, folder: Path) -> None:
        writer = ArtifactWriter(stage, folder, made_by(stage))
        content = tiny_site(folder.with_name(folder.name + "-frames"))
        if stage == "refine":
            writer.write(catalogue.RIG, rig)
        if stage == "frames":
            tiny_site(writer.new_file(catalogue.FRAMES))
        if stage == "associate":
            writer.write(catalogue.ANNOTATIONS, content.instants)
        if stage == "dataset":
            parts = {"train": tuple(t for t in TIMES_NS if t not in test), "val": (), "test": test}
            writer.write(catalogue.SPLIT, Split(times_ns=parts, left_out_tracks=dict.fromkeys(parts, frozenset[int]())))
        if stage == "finetune":
            writer.new_file(catalogue.WEIGHTS).write_bytes(WEIGHTS)
        if stage == "evaluate":
            writer.write(catalogue.METRICS, METRICS)
            off = np.array([error_m, 0, 0, 0, 0, 0, 0])
            found = [
                Vehicles3D.of(one.time_ns, one.boxes + off, one.classes, camera_id=camera, scores=np.ones(len(one)))
                for one in content.lifts
                for camera in rig
            ]
            writer.write(catalogue.PREDICTIONS_FINETUNED, [one for one in found if one.time_ns in test])
        if stage == "track":
            writer.write(catalogue.TRACKS, tracks())

    options = {"finetune": {"steps": steps}}
    job = api.http.post(f"/v1/sites/{site}/jobs", json={"name": f"{steps} steps", "options": options}).json()["id"]
    publish(api, job, write)
    [model] = api.http.get("/v1/models", params={"job": job}).json()
    return dict(model)


@pytest.fixture(scope="module")
def site(api: LiveApi) -> str:
    site = str(api.http.post("/v1/sites", json=site_of(tiny_rig()).model_dump(mode="json")).json()["id"])
    for camera in tiny_rig():
        api.upload(site, camera.encode(), camera)
    return site


@pytest.fixture(scope="module")
def pair(api: LiveApi, site: str) -> tuple[str, str]:
    """A network that errs by 0.8 m, and one that does by 0.1 m; they have two held-out instants in common."""
    rough = made_job(api, site, 0.8, TIMES_NS[1:], steps=11)
    fine = made_job(api, site, 0.1, TIMES_NS[1:], steps=12)
    return rough["id"], fine["id"]


def test_the_better_one_is_told(api: LiveApi, pair: tuple[str, str]) -> None:
    answer = api.http.get("/v1/models/compare", params={"first": pair[0], "second": pair[1]})
    assert answer.status_code == 200, answer.text
    found = answer.json()
    assert (found["instants"], found["labels"], found["cautions"]) == (3, "none", [])
    assert found["from_s"] == pytest.approx(TIMES_NS[1] * 1e-9)
    first, second = (found[name]["consistency"]["other_views"]["mean"] for name in ("first", "second"))
    assert second > first
    assert found["other_views"]["difference"] == pytest.approx(second - first)
    result = CliRunner().invoke(app, ["models", "compare", *pair], env={"WIBAM_URL": api.url, "WIBAM_TOKEN": TOKEN})
    assert result.exit_code == 0, result.output
    assert f"{first:.3f}" in result.output and f"{second - first:+.3f}" in result.output


def test_what_has_nothing_in_common_is_refused(api: LiveApi, site: str, pair: tuple[str, str]) -> None:
    other = str(api.http.post("/v1/sites", json=site_of(tiny_rig()).model_dump(mode="json")).json()["id"])
    for camera in tiny_rig():
        api.upload(other, b"another day" + camera.encode(), camera)
    elsewhere = made_job(api, other, 0.1, TIMES_NS[1:], steps=13)
    answer = api.http.get("/v1/models/compare", params={"first": pair[0], "second": elsewhere["id"]})
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert "different recordings" in answer.json()["detail"]
    missing = api.http.get("/v1/models/compare", params={"first": pair[0], "second": "model_0"})
    assert missing.status_code == 404
    assert api.http.get("/v1/models/compare", params={"first": pair[0]}).status_code == 422
