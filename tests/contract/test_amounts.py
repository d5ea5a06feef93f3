"""How good networks are by the amount of footage, over the jobs of a site."""

from __future__ import annotations

from pathlib import Path

import httpx

from tests.finished import METRICS, publish
from tests.service import LiveApi
from wibam_core.artifacts import catalogue
from wibam_core.artifacts.access import ArtifactWriter
from wibam_core.artifacts.catalogue import made_by
from wibam_core.documents.base import Histogram
from wibam_core.documents.statistics import DatasetStatistics, SubsetStatistics


def statistics(train_s: float) -> DatasetStatistics:
    """A vehicle every two seconds."""
    parts = {"train": train_s, "val": 5.0, "test": 10.0}
    nothing = Histogram(edges=[0, 1], counts=[0])
    return DatasetStatistics(
        subsets={
            name: SubsetStatistics(
                instants=4, seconds=seconds, vehicles=9, boxes=18, tracks=int(seconds / 2), left_out_tracks=0
            )
            for name, seconds in parts.items()
        },
        by_views={}, by_class={}, boxes_by_camera={}, depth_m=nothing, elevation_deg=nothing,
        vehicles_per_instant=nothing, sightings_per_track=nothing,
    )  # fmt: skip


def evaluated(api: LiveApi, site: str, train_s: float, share: float) -> str:
    """A job that learned from so much; returns its id."""
    options = {"dataset": {"train_share": share, "val_share": 0.9 - share}}
    job = str(api.http.post(f"/v1/sites/{site}/jobs", json={"name": f"{train_s:g} s", "options": options}).json()["id"])

    def write(stage: str, folder: Path) -> None:
        writer = ArtifactWriter(stage, folder, made_by(stage))
        if stage == catalogue.METRICS.stage:
            writer.write(catalogue.METRICS, METRICS)
        if stage == catalogue.DATASET_STATISTICS.stage:
            writer.write(catalogue.DATASET_STATISTICS, statistics(train_s))

    publish(api, job, write)
    return job


def test_evaluated_jobs_are_listed_by_how_much_they_learned_from(api: LiveApi) -> None:
    site = api.site(cameras=1)
    api.upload(site, b"amounts of footage")
    jobs = [evaluated(api, site, seconds, share) for seconds, share in ((40.0, 0.6), (10.0, 0.15))]
    api.http.post(f"/v1/sites/{site}/jobs", json={"name": "not yet evaluated", "options": {"dataset": {"gap_s": 1}}})
    found = api.http.get(f"/v1/sites/{site}/amounts").json()
    assert [(one["job_id"], one["name"], one["train_s"], one["train_vehicles"]) for one in found] == [
        (jobs[1], "10 s", 10.0, 5),
        (jobs[0], "40 s", 40.0, 20),
    ]
    assert found[0]["other_views"] == {"baseline": 0.4, "finetuned": 0.7}
    assert (found[0]["labels"], found[0]["recall"]) == ("none", {"baseline": None, "finetuned": None})
    assert (found[0]["test_from_s"], found[0]["test_to_s"]) == (40.0, 50.0)


def test_a_site_that_is_not_there_is_said(api: LiveApi) -> None:
    answer: httpx.Response = api.http.get("/v1/sites/site_0123456789abcdef/amounts")
    assert answer.status_code == 404
