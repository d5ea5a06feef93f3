"""A client that a generator makes of the OpenAPI document: it is made, and it works; what it is made of lasts."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from api.examples import EXAMPLES, FILE_ID, JOB_ID, SITE_ID
from tests.builders import corner_rig, site_of
from tests.conftest import ROOT
from tests.finished import finished_job
from tests.service import TOKEN, LiveApi
from wibam_core.models.weights import bundled

IDS = ROOT / "tests" / "contract" / "operation_ids.txt"
#: Bodies that are files of others, whole documents of a page, or need what no small job has.
WITHOUT_EXAMPLE = {"CalibrationFilesIn", "ClipSpec", "EvaluateIn", "LabelsIn", "MapIn", "TokenIn"}
#: Types of files that the generator does not know by their names.
FILES = (
    "application/zip",
    "application/offset+octet-stream",
    "application/vnd.apache.parquet",
    "image/jpeg",
    "video/mp4",
)


@pytest.fixture(scope="module")
def document(api: LiveApi) -> dict[str, Any]:
    return dict(api.http.get("/openapi.json").json())


@pytest.fixture(scope="module")
def generated(document: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The name of the package."""
    pytest.importorskip("openapi_python_client", reason="the generator is not installed: pip install -e '.[dev]'")
    folder = tmp_path_factory.mktemp("generated")
    (folder / "openapi.json").write_text(json.dumps(document))
    settings = {"post_hooks": [], "content_type_overrides": dict.fromkeys(FILES, "application/octet-stream")}
    (folder / "settings.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "openapi_python_client", "generate", "--meta", "none", "--fail-on-warning"]
    options = ["--path", "openapi.json", "--output-path", "wibam_generated", "--config", "settings.json"]
    made = subprocess.run([*command, *options], cwd=folder, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    sys.path.insert(0, str(folder))
    yield "wibam_generated"
    sys.path.remove(str(folder))


def test_a_generated_client_describes_a_site_starts_a_job_and_reads_what_comes_back(
    api: LiveApi, generated: str
) -> None:
    def part(name: str) -> Any:
        return importlib.import_module(f"{generated}.{name}")

    client = part("client").AuthenticatedClient(base_url=api.url, token=TOKEN)
    with client:
        description = part("models.site").Site.from_dict(site_of(corner_rig(1)).model_dump(mode="json"))
        site = part("api.sites.sites_create").sync(client=client, body=description)
        assert (site.name, site.cameras) == ("crossing", ["cam1"])
        api.upload(site.id, b"a recording")
        body = part("models.job_in").JobIn(name="by a generated client", tags=["made"])
        job = part("api.jobs.jobs_create").sync(site.id, client=client, body=body)
        found = part("api.jobs.jobs_list").sync(client=client, site=site.id, tag=["made"])
        assert [(one.id, one.name, one.tags) for one in found] == [(job.id, "by a generated client", ["made"])]
        assert found[0].state is part("models.job_state").JobState.QUEUED
        assert {stage.state.value for stage in found[0].stages} == {"queued", "pending"}
        problem = part("api.jobs.jobs_get").sync("job_0", client=client)
        assert (problem.status, problem.code) == (404, "not_found")
        archive = part("api.results.results_archive").sync_detailed(finished_job(api), client=client)
        assert archive.parsed.payload.read(2) == b"PK"


def test_operation_ids_last(document: dict[str, Any]) -> None:
    """Programs call them by their names; whoever adds an operation adds a line, and nobody changes one."""
    found = sorted(operation["operationId"] for path in document["paths"].values() for operation in path.values())
    assert len(found) == len(set(found))
    assert found == IDS.read_text().split()


def test_every_answer_says_what_it_is(document: dict[str, Any]) -> None:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for status, response in operation["responses"].items():
                for media_type, content in response.get("content", {}).items():
                    assert content.get("schema") or media_type == "text/event-stream", f"{method} {path} {status}"


def bodies(document: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Method, address and schema of what is sent as JSON."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            content = operation.get("requestBody", {}).get("content", {}).get("application/json")
            if content is not None:
                yield method, path, content["schema"]["$ref"].rpartition("/")[2]


def test_examples_run(api: LiveApi, document: dict[str, Any]) -> None:
    """Every example is taken as it is, but for ids; every body that is sent as JSON has one."""
    job = finished_job(api, b"for examples", weights=bundled("mono_small.safetensors").read_bytes())
    site = api.http.get(f"/v1/jobs/{job}").json()["site_id"]
    api.upload(site, b"footage", purpose="footage", filename="f.mp4")
    [file] = [one for one in api.http.get(f"/v1/sites/{site}/footage").json() if one["filename"] == "f.mp4"]
    [model] = api.http.get("/v1/models", params={"job": job}).json()
    hook = api.http.post("/v1/webhooks", json={"url": "https://example.org/x"}).json()["id"]
    there = {"site_id": site, "job_id": job, "file_id": file["id"], "model_id": model["id"], "webhook_id": hook}
    there |= {"conflict_id": 0}
    sent = set()
    for method, path, schema in sorted(bodies(document), key=lambda body: body[1].endswith(("/restart", "/runs"))):
        if schema in WITHOUT_EXAMPLE:
            continue
        assert document["components"]["schemas"][schema]["examples"] == [EXAMPLES[schema]]
        given = json.dumps(EXAMPLES[schema])
        for example, real in ((SITE_ID, site), (JOB_ID, job), (FILE_ID, file["id"])):
            given = given.replace(example, real)
        headers = {"Content-Type": "application/json"}
        if (method, path) == ("put", "/v1/sites/{site_id}"):
            path = f"/v1/sites/{api.site()}"  # one without recordings, which are of other cameras
        answer = api.http.request(method.upper(), path.format(**there), content=given, headers=headers)
        assert answer.is_success, f"{method} {path}: {answer.text}"
        sent.add(schema)
    assert sent == set(EXAMPLES)
