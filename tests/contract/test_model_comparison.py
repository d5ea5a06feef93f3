"""Two networks of two jobs compared over real HTTP, by a confined process, on the instants that both have held out."""

from __future__ import annotations

import pytest
import typer
from typer.testing import CliRunner

from tests.compared_jobs import made_job, tiny_site_with_recordings
from tests.labelled_job import TIMES_NS
from tests.service import TOKEN, LiveApi
from wibam_core.cli import models

app = typer.Typer()
app.add_typer(models.app, name="models")


@pytest.fixture(scope="module")
def site(api: LiveApi) -> str:
    return tiny_site_with_recordings(api)


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
    other = tiny_site_with_recordings(api, b"another day")
    elsewhere = made_job(api, other, 0.1, TIMES_NS[1:], steps=13)
    answer = api.http.get("/v1/models/compare", params={"first": pair[0], "second": elsewhere["id"]})
    assert (answer.status_code, answer.json()["code"]) == (409, "conflict")
    assert "different recordings" in answer.json()["detail"]
    missing = api.http.get("/v1/models/compare", params={"first": pair[0], "second": "model_0"})
    assert missing.status_code == 404
    assert api.http.get("/v1/models/compare", params={"first": pair[0]}).status_code == 422
