"""Resumable uploads: tus 1.0 with creation, expiration, termination and checksum (https://tus.io)."""

from __future__ import annotations

import base64
import binascii
from email.utils import formatdate
from typing import Annotated

import anyio
from fastapi import APIRouter, Depends, Header, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from api.problems import documented
from api.services import ServicesDep
from wibam_core.adapters.site_store import UploadRequest
from wibam_core.adapters.uploads import CHECKSUMS, Checksum, Piece
from wibam_core.errors import InputError, WibamError
from wibam_core.jobs.records import Purpose, Upload

_VERSION = "1.0.0"
_BLOCK = 1024 * 1024
_CONTENT_TYPE = "application/offset+octet-stream"


class TusVersionMismatch(WibamError):
    code = "tus_version"
    default_hint = f"Send the header Tus-Resumable: {_VERSION}."


class WrongContentType(WibamError):
    code = "wrong_content_type"
    default_hint = f"Send the bytes as Content-Type: {_CONTENT_TYPE}."


router = APIRouter(prefix="/v1/uploads", tags=["uploads"])
TusVersion = Annotated[str, Header(alias="Tus-Resumable", description=f"must be {_VERSION}")]


def _tus_headers(response: Response) -> None:
    response.headers["Tus-Resumable"] = _VERSION


tus = [Depends(_tus_headers)]


@router.options("", status_code=204, summary="What this tus server can do")
@router.options("/{upload_id}", status_code=204, include_in_schema=False)
def options(response: Response) -> None:
    response.headers.update(
        {
            "Tus-Resumable": _VERSION,
            "Tus-Version": _VERSION,
            "Tus-Extension": "creation,expiration,termination,checksum",
            "Tus-Checksum-Algorithm": ",".join(CHECKSUMS),
        }
    )


@router.post(
    "",
    status_code=201,
    dependencies=tus,
    summary="Begin an upload",
    responses=documented(401, 404, 412, 413, 422, 507),
)
def create(
    services: ServicesDep,
    response: Response,
    upload_length: Annotated[int, Header(ge=0, description="size of the file in bytes")],
    upload_metadata: Annotated[
        str,
        Header(
            description="`key base64,key base64`: `site` (id), `purpose` (recording, labels or detector), `camera` "
            "(of a recording), `filename` (for showing only)"
        ),
    ],
    tus_resumable: TusVersion = "",
) -> None:
    """The upload's address comes in the header `Location`."""
    _check_version(tus_resumable)
    upload = services.uploads.create(_request(upload_length, parse_metadata(upload_metadata)))
    response.headers["Location"] = f"/v1/uploads/{upload.id}"
    response.headers["Upload-Expires"] = _expires(upload)


@router.head("/{upload_id}", dependencies=tus, summary="Where does an upload stand?", responses=documented(404, 410))
def head(upload_id: str, services: ServicesDep, response: Response, tus_resumable: TusVersion = "") -> None:
    """`Upload-Offset` bytes are safely on the service's disk."""
    _check_version(tus_resumable)
    upload = services.uploads.upload(upload_id)
    response.headers.update(
        {
            "Upload-Offset": str(upload.offset),
            "Upload-Length": str(upload.length),
            "Upload-Expires": _expires(upload),
            "Cache-Control": "no-store",
        }
    )


@router.patch(
    "/{upload_id}",
    status_code=204,
    dependencies=tus,
    summary="Send bytes",
    responses=documented(401, 404, 409, 410, 412, 413, 415, 423, 460, 507),
    openapi_extra={"requestBody": {"content": {_CONTENT_TYPE: {"schema": {"type": "string", "format": "binary"}}}}},
)
async def patch(
    upload_id: str,
    request: Request,
    services: ServicesDep,
    upload_offset: Annotated[int, Header(ge=0, description="where these bytes belong")],
    content_type: Annotated[str, Header()] = "",
    upload_checksum: Annotated[str | None, Header(description="`sha256 base64` of these bytes")] = None,
    tus_resumable: TusVersion = "",
) -> Response:
    """Bytes that arrived before a connection broke are kept: ask with HEAD how many, and go on there."""
    _check_version(tus_resumable)
    if content_type.split(";")[0].strip().lower() != _CONTENT_TYPE:
        raise WrongContentType(f"the content type is {content_type or 'missing'}")
    checksum = parse_checksum(upload_checksum) if upload_checksum is not None else None
    piece = services.uploads.piece(upload_id, upload_offset, checksum)
    await run_in_threadpool(piece.__enter__)
    try:
        if not await _receive(request, piece):
            return Response(status_code=400)  # nobody is there to read it
        upload = await run_in_threadpool(piece.finish)
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(piece.__exit__, None, None, None)
    return Response(
        status_code=204,
        headers={"Upload-Offset": str(upload.offset), "Upload-Expires": _expires(upload), "Tus-Resumable": _VERSION},
    )


@router.delete(
    "/{upload_id}", status_code=204, dependencies=tus, summary="Drop an upload", responses=documented(401, 404, 423)
)
def delete(upload_id: str, services: ServicesDep, tus_resumable: TusVersion = "") -> None:
    """The recording that a complete upload became stays."""
    _check_version(tus_resumable)
    services.uploads.delete(upload_id)


async def _receive(request: Request, piece: Piece) -> bool:
    """Pump the body into the upload, a bounded block at a time. Returns whether all of it came."""
    block = bytearray()
    try:
        async for chunk in request.stream():
            block += chunk
            if len(block) >= _BLOCK:
                await run_in_threadpool(piece.write, bytes(block))
                block.clear()
    except ClientDisconnect:
        await run_in_threadpool(piece.write, bytes(block))
        await run_in_threadpool(piece.interrupted)
        return False
    await run_in_threadpool(piece.write, bytes(block))
    return True


def parse_metadata(header: str) -> dict[str, str]:
    """``Upload-Metadata`` as tus writes it.

    Raises:
        InputError: it is not that.
    """
    metadata: dict[str, str] = {}
    for pair in filter(None, (part.strip() for part in header.split(","))):
        key, _, value = pair.partition(" ")
        try:
            metadata[key] = base64.b64decode(value, validate=True).decode("utf-8")
        except (binascii.Error, UnicodeDecodeError):
            raise InputError(f"Upload-Metadata: {key!r} is not base64 of UTF-8", hint="See https://tus.io.") from None
    return metadata


def parse_checksum(header: str) -> Checksum:
    """``Upload-Checksum`` as tus writes it.

    Raises:
        InputError: it is not that.
    """
    algorithm, _, encoded = header.partition(" ")
    try:
        return Checksum(algorithm, base64.b64decode(encoded, validate=True))
    except binascii.Error:
        raise InputError("Upload-Checksum is not an algorithm and base64", hint="See https://tus.io.") from None


def _request(length: int, metadata: dict[str, str]) -> UploadRequest:
    try:
        purpose = Purpose(metadata.get("purpose", "recording"))
    except ValueError:
        raise InputError(
            f"no purpose {metadata['purpose']!r}", hint=f"Use one of {', '.join(purpose.value for purpose in Purpose)}."
        ) from None
    if "site" not in metadata:
        raise InputError("Upload-Metadata names no site", hint="Send the site's id as 'site'.")
    return UploadRequest(metadata["site"], purpose, metadata.get("camera", ""), metadata.get("filename", ""), length)


def _check_version(version: str) -> None:
    if version != _VERSION:
        raise TusVersionMismatch(f"this is tus {_VERSION}, not {version or 'an unnamed version'}")


def _expires(upload: Upload) -> str:
    return formatdate(upload.expires_at, usegmt=True)
