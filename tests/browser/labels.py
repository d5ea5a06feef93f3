"""Labels as the service has them, beside the page that is looked at."""

from __future__ import annotations

from typing import Any

from tests.service import LiveApi


def saved(api: LiveApi, job: str, name: str, time_ns: int) -> Any:
    """An instant of a set of labels, with its version."""
    return api.http.get(f"/v1/jobs/{job}/labels/instants/{time_ns}", params={"set": name}).json()


def put(
    api: LiveApi, job: str, name: str, time_ns: int, version: int, vehicles: list[Any], author: str = "ben"
) -> None:
    """Save an instant as somebody else."""
    answer = api.http.put(
        f"/v1/jobs/{job}/labels/instants/{time_ns}",
        params={"set": name},
        headers={"If-Match": f'"{version}"'},
        json={"author": author, "vehicles": vehicles, "finished": True},
    )
    assert answer.status_code == 200, answer.text
