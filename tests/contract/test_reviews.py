"""Reviews of conflicts: kept, replaced, taken back, exported."""

from __future__ import annotations

import csv
import io

import pytest

from tests.finished import finished_job
from tests.service import LiveApi
from tests.unit.report.test_conflict_table import pages_of


@pytest.fixture
def job(api: LiveApi) -> str:
    return finished_job(api)


def test_a_review_is_kept_replaced_and_taken_back(api: LiveApi, job: str) -> None:
    address = f"/v1/jobs/{job}/conflicts"
    assert api.http.get(f"{address}/reviews").json() == []
    said = api.http.put(f"{address}/0/review", json={"verdict": "rejected", "note": "a parked car"}).json()
    assert api.http.get(f"{address}/reviews").json() == [said]
    assert (said["conflict_id"], said["verdict"], said["note"]) == (0, "rejected", "a parked car")
    api.http.put(f"{address}/0/review", json={"verdict": "confirmed"})
    [now] = api.http.get(f"{address}/reviews").json()
    assert (now["verdict"], now["note"]) == ("confirmed", "")
    assert api.http.delete(f"{address}/0/review").status_code == 204
    assert api.http.get(f"{address}/reviews").json() == []


def test_the_table_has_them(api: LiveApi, job: str) -> None:
    api.http.put(f"/v1/jobs/{job}/conflicts/0/review", json={"verdict": "confirmed", "note": 'braked, "hard"'})
    text = api.http.get(f"/v1/jobs/{job}/conflicts", params={"format": "csv", "reviews": True}).text
    [row] = csv.DictReader(io.StringIO(text))
    assert (row["conflict_id"], row["verdict"], row["note"]) == ("0", "confirmed", 'braked, "hard"')
    plain = api.http.get(f"/v1/jobs/{job}/conflicts", params={"format": "csv"}).text
    assert "verdict" not in plain


def test_the_table_is_a_pdf_file_too(api: LiveApi, job: str) -> None:
    """Made apart, in a process that reaches nothing."""
    api.http.put(f"/v1/jobs/{job}/conflicts/0/review", json={"verdict": "confirmed", "note": "braked"})
    answer = api.http.get(f"/v1/jobs/{job}/conflicts", params={"format": "pdf", "reviews": True})
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"] == "application/pdf"
    assert f'filename="{job}-conflicts.pdf"' in answer.headers["content-disposition"]
    assert any("confirmed" in page and "braked" in page for page in pages_of(answer.content))
    plain = api.http.get(f"/v1/jobs/{job}/conflicts", params={"format": "pdf"}).content
    assert all("confirmed" not in page for page in pages_of(plain))


def test_what_is_not_there_cannot_be_reviewed(api: LiveApi, job: str) -> None:
    body = {"verdict": "confirmed"}
    assert api.http.put(f"/v1/jobs/{job}/conflicts/7/review", json=body).status_code == 404
    assert api.http.put("/v1/jobs/job_0/conflicts/0/review", json=body).status_code == 404
    assert api.http.put(f"/v1/jobs/{job}/conflicts/0/review", json={"verdict": "perhaps"}).status_code == 422


def test_they_go_with_the_job(api: LiveApi, job: str) -> None:
    api.http.put(f"/v1/jobs/{job}/conflicts/0/review", json={"verdict": "confirmed"})
    assert api.http.delete(f"/v1/jobs/{job}").status_code == 204
    assert api.http.get(f"/v1/jobs/{job}/conflicts/reviews").status_code == 404
