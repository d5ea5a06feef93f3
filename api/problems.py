"""Errors as RFC 9457 problem details. Every error of the core is mapped to a status here, and nowhere else."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.encoders import jsonable_encoder
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import DataError, OperationalError
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.routing import Match

from api.access import REQUEST_ID, current_visit
from wibam_core.errors import InputError, ServiceUnavailable, WibamError

MEDIA_TYPE = "application/problem+json"
_log = logging.getLogger(__name__)

#: Status by `WibamError.code`; other `InputError`s are 422, everything else is 500.
STATUS: Mapping[str, int] = {
    "ambiguous_length": 400,
    "unauthorised": 401,
    "cross_site": 403,
    "forbidden": 403,
    "not_found": 404,
    "upload_stalled": 408,
    "conflict": 409,
    "upload_expired": 410,
    "changed_meanwhile": 412,
    "tus_version": 412,
    "quota_exceeded": 413,
    "too_large": 413,
    "wrong_content_type": 415,
    "locked": 423,
    "checksum_mismatch": 460,
    "unknown_checksum": 400,
    "service_unavailable": 503,
    "disk_full": 507,
}
_METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
_JSON_HINT = "Send JSON in UTF-8, with Content-Type: application/json."
_CODE_OF_STATUS = {
    400: "invalid_json",
    401: "unauthorised",
    404: "not_found",
    405: "method_not_allowed",
    408: "too_slow",
    413: "too_large",
}


class Problem(BaseModel):
    """What went wrong (RFC 9457), and what to do about it."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "urn:wibam:problem:missing_camera",
                    "title": "Unprocessable Content",
                    "status": 422,
                    "detail": "there is no recording of camera north",
                    "code": "missing_camera",
                    "hint": "Upload a recording for every camera the site names, or remove the camera from the site.",
                    "details": {"cameras": ["north"]},
                }
            ]
        }
    )

    type: str = Field(description="a stable name of the kind of problem: `urn:wibam:problem:` and the code")
    title: str = Field(description="the status in words")
    status: int
    detail: str = Field(description="one sentence for a person")
    code: str = Field(description="stable, for programs")
    hint: str = Field("", description="what can be done about it")
    details: dict[str, Any] = Field({}, description="facts, for programs")
    request_id: str = Field("", description="names the request in the service's log; in the header `X-Request-ID`, too")


def problem(error: WibamError, status: int | None = None, headers: Mapping[str, str] | None = None) -> JSONResponse:
    """An error as a response."""
    status = status_of(error) if status is None else status
    visit = current_visit.get()
    if visit is not None:
        visit.problem = error.code
    request_id = visit.request_id if visit is not None else ""
    body = Problem(
        type=f"urn:wibam:problem:{error.code}",
        title=_title(status),
        status=status,
        detail=error.message,
        code=error.code,
        hint=error.hint,
        details=jsonable_encoder(error.details),
        request_id=request_id,
    )
    headers = dict(headers or {})
    if request_id:
        headers[REQUEST_ID] = request_id  # what fails unforeseen is answered outside of all that sets it otherwise
    if status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    return JSONResponse(body.model_dump(), status, headers, MEDIA_TYPE)


def status_of(error: WibamError) -> int:
    """The HTTP status of an error of the core."""
    return STATUS.get(error.code, 422 if isinstance(error, InputError) else 500)


def database_problem(error: Exception) -> JSONResponse:
    """What a user learns where the database does not answer; the log learns the rest."""
    _log.error("the database failed", exc_info=error)
    return problem(ServiceUnavailable("the database does not answer", hint="Try again in a moment."))


def documented(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """The error responses of a route, for OpenAPI."""
    schema = {"schema": {"$ref": "#/components/schemas/Problem"}}
    return {status: {"description": _title(status), "content": {MEDIA_TYPE: schema}} for status in statuses}


def add_handlers(app: FastAPI) -> None:
    """Let every error leave the application as a problem."""
    app.add_exception_handler(WibamError, _wibam_error)
    app.add_exception_handler(RequestValidationError, _validation_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(OperationalError, _database_error)
    app.add_exception_handler(DataError, _data_error)
    app.add_exception_handler(Exception, _unexpected)


def first_problem(errors: list[Any]) -> tuple[str, str]:
    """Field and problem of the first validation error."""
    first = errors[0]
    return ".".join(str(part) for part in first["loc"]), str(first["msg"])


async def _wibam_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, WibamError)
    return problem(error)


async def _validation_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    errors = list(error.errors())
    field, what = first_problem(errors)
    fields = [{"field": ".".join(map(str, e["loc"])), "problem": e["msg"]} for e in errors[:20]]
    if errors[0]["type"] == "json_invalid":
        why = errors[0].get("ctx", {}).get("error", "")
        message = "the body is not valid JSON" + (f": {why}" if why else "")
        return problem(_coded("invalid_json", message, _JSON_HINT, errors=fields), 400)
    return problem(InputError(f"{field}: {what}", hint="Correct this field; /docs describes them all.", errors=fields))


async def _http_error(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    status, message, headers = error.status_code, str(error.detail), dict(error.headers or {})
    hint = str(getattr(error, "hint", ""))
    if status == 400:
        message, hint = "the body cannot be read", _JSON_HINT
    elif status == 404 and message == HTTPStatus.NOT_FOUND.phrase:
        message, hint = f"there is nothing at {request.url.path}", "/docs lists all addresses."
    elif status == 405:
        allowed = ", ".join(_methods(request))
        message, hint = f"{request.url.path} does not take {request.method}", f"It takes {allowed}."
        headers["Allow"] = allowed
    return problem(_coded(_CODE_OF_STATUS.get(status, "http_error"), message, hint), status, headers)


async def _database_error(request: Request, error: Exception) -> JSONResponse:
    return database_problem(error)


async def _data_error(request: Request, error: Exception) -> JSONResponse:
    """PostgreSQL takes no NUL in a text and no number beyond its column's range; SQLite takes both."""
    _log.warning("the database does not take a value of a request", exc_info=error)
    hint = "Leave out control characters and numbers that are far too large."
    return problem(InputError("a value of the request is none that can be stored or looked for", hint=hint))


async def _unexpected(request: Request, error: Exception) -> JSONResponse:
    return problem(WibamError("something went wrong inside the service", hint="The service's log tells more."), 500)


def _methods(request: Request) -> list[str]:
    """What the address takes, of all routes that lead to it; Starlette names those of the first."""

    def takes(method: str) -> bool:
        asked = {**request.scope, "method": method}
        return any(route.matches(asked)[0] is Match.FULL for route in request.app.routes)

    return [method for method in _METHODS if takes(method)]


def _coded(code: str, message: str, hint: str, **details: Any) -> WibamError:
    return WibamError.from_dict({"code": code, "message": message, "hint": hint, "details": details})


def _title(status: int) -> str:
    return "Checksum Mismatch" if status == 460 else HTTPStatus(status).phrase
