"""The OpenAPI document, with what FastAPI cannot know: the token, the form of errors, and names that last."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute

from api.access import is_protected, needed_scope
from api.examples import EXAMPLES
from api.problems import Problem, documented
from api.sessions import SESSION_COOKIE


def document_of(app: FastAPI) -> dict[str, Any]:
    """The document of an application, made once."""
    if app.openapi_schema is None:
        app.openapi_schema = _document(app)
    return app.openapi_schema


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description=app.description,
        license_info=app.license_info,
        routes=app.routes,
    )
    components = document["components"]
    components["schemas"]["Problem"] = Problem.model_json_schema()
    for unused in ("HTTPValidationError", "ValidationError"):
        components["schemas"].pop(unused, None)
    for name, schema in components["schemas"].items():
        if schema.get("title") == name:
            del schema["title"]
        for one in schema.get("properties", {}).values():
            _without_title(one)
    for name, example in EXAMPLES.items():
        components["schemas"][name]["examples"] = [example]
    components["securitySchemes"] = {
        "token": {"type": "http", "scheme": "bearer"},
        "session": {"type": "apiKey", "in": "cookie", "name": SESSION_COOKIE},
    }
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _with_problems(operation)
            _with_files(method, operation)
            for parameter in operation.get("parameters", ()):
                _without_title(parameter["schema"])
                if parameter["schema"].get("description") == parameter.get("description"):
                    parameter["schema"].pop("description", None)  # it would be said twice
            if is_protected(method.upper(), path):
                scope = needed_scope(method.upper(), path).value
                operation["security"] = [{"token": [scope]}, {"session": []}]
                operation["responses"].setdefault("403", documented(403)[403])
    _share_problems(document)
    return document


def _share_problems(document: dict[str, Any]) -> None:
    """Say once what a refusal is, for all operations: together they were a fifth of the document."""
    content = {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}
    shared: dict[str, Any] = {}
    for operation in (one for operations in document["paths"].values() for one in operations.values()):
        for status, response in operation["responses"].items():
            if response.get("content") == content:
                shared.setdefault(f"Problem{status}", response)
                operation["responses"][status] = {"$ref": f"#/components/responses/Problem{status}"}
    document["components"]["responses"] = dict(sorted(shared.items()))


def _with_problems(operation: dict[str, Any]) -> None:
    invalid = operation["responses"].get("422", {})
    if "application/json" in invalid.get("content", {}):
        schema = {"schema": {"$ref": "#/components/schemas/Problem"}}
        invalid["description"], invalid["content"] = "Unprocessable Content", {"application/problem+json": schema}


def _with_files(method: str, operation: dict[str, Any]) -> None:
    """Files are strings of bytes to OpenAPI; those of any type are said to be so."""
    for status, response in operation["responses"].items():
        if method == "get" and status == "200" and "content" not in response:
            response["content"] = {"application/octet-stream": {}}
        for media_type, content in response.get("content", {}).items():
            if "schema" not in content and "json" not in media_type:
                is_text = media_type.startswith("text/")
                content["schema"] = {"type": "string"} if is_text else {"type": "string", "format": "binary"}


def operation_id(route: APIRoute) -> str:
    """The name of an operation, for generated clients: its module and its function, wherever its address leads.

    They are listed in tests/contract/operation_ids.txt: one that changes breaks its users' programs.
    """
    module = str(route.endpoint.__module__).rpartition(".")[2]
    verb = route.name.removesuffix(f"_{module}").removesuffix(f"_{module.removesuffix('s')}")
    return f"{module}_{verb}"


def _without_title(schema: dict[str, Any]) -> None:
    """Titles of fields and parameters are their names, written otherwise: a quarter of the document."""
    schema.pop("title", None)
