"""Requests that nobody would write, made of the OpenAPI document: each is answered as documented, at a bounded cost."""

from __future__ import annotations

import json
import time
import tracemalloc
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from api.examples import EXAMPLES
from tests.finished import finished_job
from tests.service import LiveApi

#: What any operation may answer: the body is no JSON or too long, the address is none, the token is missing.
ALWAYS = {"400", "401", "404", "413", "422"}
#: The browser's own, and one that does not end by itself.
LEFT_OUT = {"/session", "/v1/jobs/{job_id}/events"}
#: These open a file in a process of its own, which costs seconds however small the request is.
LOOK_INTO_FILES = ("/header", "/frame", "/signal", "/compare", "/map", "/archive")
#: CPU seconds of API and client together, and bytes of memory: at once, and for each byte that is sent. A list of empty
#: cameras once took 33e-6 s and 1,700 bytes for each.
START_S, PER_BYTE_S = 1.5, 6e-6
START_BYTES, PER_BYTE_BYTES = 24_000_000, 150
FLOOD_BYTES = 60_000

Operation = tuple[str, str, dict[str, Any]]


@pytest.fixture(scope="module")
def document(api: LiveApi) -> dict[str, Any]:
    return dict(api.http.get("/openapi.json").json())


@pytest.fixture(scope="module")
def ids(api: LiveApi) -> dict[str, str]:
    job = finished_job(api)
    site = api.http.get(f"/v1/jobs/{job}").json()["site_id"]
    return {"job_id": job, "site_id": site, "stage": "track", "name": "tracks.parquet", "conflict_id": "0"}


def operations(document: dict[str, Any]) -> list[Operation]:
    found = [(m, path, op) for path, ops in document["paths"].items() for m, op in ops.items() if path not in LEFT_OUT]
    return sorted(found, key=lambda one: (one[1], one[0]))


def values(schema: dict[str, Any], document: dict[str, Any], depth: int = 0) -> st.SearchStrategy[Any]:
    """What a schema takes, more or less, and now and then something else."""
    if "$ref" in schema:
        named = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
        return st.just({}) if depth > 6 else values(named, document, depth + 1)
    if "enum" in schema:
        return st.sampled_from(schema["enum"]) | JUNK
    for several in ("anyOf", "oneOf"):
        if several in schema:
            return st.one_of(*(values(one, document, depth + 1) for one in schema[several]))
    kind = schema.get("type")
    if kind == "object":
        fields = schema.get("properties", {})
        required = {name: values(fields[name], document, depth + 1) for name in schema.get("required", ())}
        optional = {name: values(one, document, depth + 1) for name, one in fields.items() if name not in required}
        return st.fixed_dictionaries(required, optional=optional) | JUNK
    if kind == "array":
        return st.lists(values(schema.get("items", {}), document, depth + 1), max_size=3) | JUNK
    plain: dict[Any, st.SearchStrategy[Any]] = {
        "string": st.text(max_size=8)
        | st.sampled_from(["2026-07-01T08:00:00Z", "é\0", "x" * 3000, "-1,1,2,3", "1,2;3,4;0,9"]),
        "integer": st.integers(-(2**70), 2**70) | st.integers(0, 9),
        "number": st.floats() | st.integers(-9, 9),
        "boolean": st.booleans(),
        "null": st.none(),
    }
    return plain.get(kind, JUNK) | JUNK


ODD_TEXTS = st.sampled_from(["2026-07-01T08:00:00Z", "é\0", "x" * 3000, "-1,1,2,3", "1,2;3,4;0,9"])
JUNK = st.sampled_from([None, [], {}, 0, -1, 1e308, "", "x", "\ud800", [[]], {"a": {"b": [1]}}, 2**63, "a\0b", True])


@st.composite
def requests(draw: st.DrawFn, document: dict[str, Any], ids: dict[str, str]) -> tuple[Operation, str, Any, Any]:
    """An operation, its address, query and body (None: none)."""
    method, path, operation = draw(st.sampled_from(operations(document)))
    may_be_real = method != "delete" and not path.endswith(LOOK_INTO_FILES)
    address, query = path, []
    for parameter in operation.get("parameters", ()):
        name = parameter["name"]
        if parameter["in"] == "path":
            odd = st.sampled_from(["x", "a..b", "a\0b", "%", "y" * 300, "-1", "🚗"])
            real = st.just(ids[name]) if may_be_real and name in ids else odd
            address = address.replace(f"{{{name}}}", quote(draw(real | real | odd), safe=""))
        elif parameter["in"] == "query" and draw(st.booleans()):
            given_value = draw(values(parameter["schema"], document))
            several = given_value if isinstance(given_value, list) else [given_value]
            query += [(name, str(one).encode("utf-8", "replace").decode()) for one in several]
    content = operation.get("requestBody", {}).get("content", {}).get("application/json")
    body = draw(values(content["schema"], document)) if content is not None else None
    return (method, path, operation), address, query, body


@settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_any_request_is_answered_as_documented(
    api: LiveApi, document: dict[str, Any], ids: dict[str, str], data: st.DataObject
) -> None:
    (method, _, operation), address, query, body = data.draw(requests(document, ids))
    content = None if body is None else json.dumps(body).encode()
    headers = {} if body is None else {"Content-Type": "application/json"}
    answer = api.http.request(method.upper(), address, params=query, content=content, headers=headers)
    said = f"{method} {address} {query} {body!r}: {answer.status_code} {answer.text[:300]}"
    assert answer.status_code < 500 or answer.status_code == 503, said
    assert str(answer.status_code) in {*operation["responses"], *ALWAYS}, said
    if answer.status_code >= 400 and method != "head":
        assert answer.headers["content-type"] == "application/problem+json", said
        assert answer.json()["detail"] and len(answer.content) < 50_000, said


def floods(schema: str, *, any_form: bool) -> Iterator[bytes]:
    """Long bodies of one kind: in place of each list and object of the example very many of the same.

    With ``any_form`` also those that are refused before anything is made of them, the same by every operation.
    """
    example = EXAMPLES.get(schema, {})
    for name, value in example.items():
        if isinstance(value, list):
            for one in ({}, 0):
                yield json.dumps({**example, name: [one] * (FLOOD_BYTES // 4)}).encode()
        if isinstance(value, dict):
            yield json.dumps({**example, name: dict.fromkeys(map(str, range(FLOOD_BYTES // 12)), 0)}).encode()
    if any_form:
        yield json.dumps({**example, "name": "é" * (FLOOD_BYTES // 6)}).encode()
        yield b"[" * FLOOD_BYTES
        yield b'{"a":' * (FLOOD_BYTES // 5)
        yield b'{"a": ' + b"9" * FLOOD_BYTES + b"}"
        yield json.dumps(dict.fromkeys(map(str, range(FLOOD_BYTES // 12)))).encode()


def bodies(document: dict[str, Any]) -> list[tuple[str, str, str]]:
    found = {}
    for method, path, operation in operations(document):
        content = operation.get("requestBody", {}).get("content", {}).get("application/json")
        if content is not None:
            found.setdefault(content["schema"]["$ref"].rpartition("/")[2], (method, path))
    return [(method, path, schema) for schema, (method, path) in found.items()]


def test_what_a_request_costs_grows_with_its_length_alone(
    api: LiveApi, document: dict[str, Any], ids: dict[str, str]
) -> None:
    for method, path, schema in bodies(document):
        address = path.format(**{**dict.fromkeys(("model_id", "webhook_id", "file_id", "time_ns"), "0"), **ids})
        for body in floods(schema, any_form=schema == "Site"):
            tracemalloc.start()
            try:
                started = time.process_time()
                answer = api.http.request(
                    method.upper(), address, content=body, headers={"Content-Type": "application/json"}
                )
                cpu_s, peak = time.process_time() - started, tracemalloc.get_traced_memory()[1]
            finally:
                tracemalloc.stop()
            said = f"{method} {path} with {body[:60]!r}...: {answer.status_code}, {cpu_s:.2f} s, {peak / 1e6:.1f} MB"
            assert answer.status_code in (400, 404, 409, 413, 422), said
            assert cpu_s < START_S + PER_BYTE_S * len(body), said
            assert peak < START_BYTES + PER_BYTE_BYTES * len(body), said
