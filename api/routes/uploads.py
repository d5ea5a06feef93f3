"""Resumable uploads: tus 1.0 with creation (with the first bytes along), expiration, termination and checksum (https://tus.io)."""

from __future__ import annotations

import base64
from collections.abc import AsyncIterator
from email.utils import formatdate
from typing import Annotated

import anyio
from fastapi import APIRouter, Header, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from api.addresses import address
from api.problems import documented, problem
from api.security import UPLOAD_CONTENT_TYPE
from api.services import ServicesDep
from api.times import parse_time
from api.tus import EXTENSIONS, TUS_VERSION
from wibam_core.adapters.site_store import UploadRequest
from wibam_core.adapters.uploads import CHECKSUMS, Checksum, Piece
from wibam_core.errors import InputError, UnknownChecksum, WibamError
from wibam_core.jobs.records import Purpose, Upload
from wibam_core.text import nfc

_BLOCK = 1024 * 1024
_IDLE_S = 30.0  # a connection that brings no byte for so long is given up: it holds the upload
_MOST = 2**63 - 1  # what a database takes


class TusVersionMismatch(WibamError):
    code = "tus_version"
    default_hint = f"Send the header Tus-Resumable: {TUS_VERSION}."


class WrongContentType(WibamError):
    code = "wrong_content_type"
    default_hint = f"Send the bytes as Content-Type: {UPLOAD_CONTENT_TYPE}."


class UploadStalled(WibamError):
    code = "upload_stalled"
    default_hint = "What arrived is kept: ask for the offset with HEAD and go on there."


router = APIRouter(prefix="/v1/uploads", tags=["uploads"])
_BYTES = {"requestBody": {"content": {UPLOAD_CONTENT_TYPE: {"schema": {"type": "string", "format": "binary"}}}}}
TusVersion = Annotated[str, Header(alias="Tus-Resumable", description=f"must be {TUS_VERSION}")]


@router.options("", status_code=204, summary="What this tus server can do")
@router.options("/{upload_id}", status_code=204, include_in_schema=False)
def options(response: Response) -> None:
    response.headers.update(
        {
            "Tus-Version": TUS_VERSION,
            "Tus-Extension": ",".join(EXTENSIONS),
            "Tus-Checksum-Algorithm": ",".join(CHECKSUMS),
        }
    )


@router.post(
    "",
    status_code=201,
    response_class=Response,  # no body
    summary="Begin an upload",
    responses=documented(400, 401, 404, 408, 409, 412, 413, 422, 507),
    openapi_extra={
        "requestBody": {"content": {UPLOAD_CONTENT_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
    },
)
async def create(
    services: ServicesDep,
    request: Request,
    upload_length: Annotated[int, Header(ge=0, le=_MOST, description="size of the file in bytes")],
    upload_metadata: Annotated[
        str,
        Header(
            description="`key base64,key base64`: `site` (id), `purpose` (recording, footage, labels, detector, "
            "network, model or map), `camera` (of a recording or footage), `started_at` (of these: when the first "
            "frame was taken, ISO 8601 with its offset from UTC), `filename` (for showing; of a camera whose "
            "recordings the site lists, one of these names)"
        ),
    ],
    content_type: Annotated[str, Header()] = "",
    tus_resumable: TusVersion = "",
) -> Response:
    """The upload's address comes in the header `Location`. The first bytes, or all, may come along as the body."""
    _check_version(tus_resumable)
    upload = await run_in_threadpool(services.uploads.create, _request(upload_length, upload_metadata))
    headers = {"Location": address(request, f"/v1/uploads/{upload.id}"), "Upload-Expires": _expires(upload)}
    if _is_piece(content_type):
        received = await _take_piece(request, services.uploads.piece(upload.id, 0))
        if isinstance(received, Response):
            received.headers.update(headers)
            return received
        headers["Upload-Offset"] = str(received.offset)
    return Response(status_code=201, headers=headers)


@router.head(
    "/{upload_id}", response_class=Response, summary="Where does an upload stand?", responses=documented(404, 410, 412)
)
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
    if metadata := services.sites.upload_metadata(upload_id):
        response.headers["Upload-Metadata"] = metadata


@router.patch(
    "/{upload_id}",
    status_code=204,
    summary="Send bytes",
    responses=documented(401, 404, 408, 409, 410, 412, 413, 415, 423, 460, 507),
    openapi_extra={
        "requestBody": {"content": {UPLOAD_CONTENT_TYPE: {"schema": {"type": "string", "format": "binary"}}}}
    },
)
async def patch(
    upload_id: str,
    request: Request,
    services: ServicesDep,
    upload_offset: Annotated[int, Header(ge=0, le=_MOST, description="where these bytes belong")],
    content_type: Annotated[str, Header()] = "",
    upload_checksum: Annotated[str | None, Header(description="`sha256 base64` of these bytes")] = None,
    tus_resumable: TusVersion = "",
) -> Response:
    """Bytes that arrived before a connection broke are kept: ask with HEAD how many, and go on there."""
    _check_version(tus_resumable)
    if not _is_piece(content_type):
        raise WrongContentType(f"the content type is {content_type or 'missing'}")
    checksum = parse_checksum(upload_checksum) if upload_checksum is not None else None
    received = await _take_piece(request, services.uploads.piece(upload_id, upload_offset, checksum))
    if isinstance(received, Response):
        return received
    return Response(
        status_code=204,
        headers={"Upload-Offset": str(received.offset), "Upload-Expires": _expires(received)},
    )


@router.delete("/{upload_id}", status_code=204, summary="Drop an upload", responses=documented(401, 404, 412, 423))
def delete(upload_id: str, services: ServicesDep, tus_resumable: TusVersion = "") -> None:
    """The recording that a complete upload became stays."""
    _check_version(tus_resumable)
    services.uploads.delete(upload_id)


async def _take_piece(request: Request, piece: Piece) -> Upload | Response:
    """The upload after the body was taken in, or the answer where it broke off; what came until then is kept."""
    await run_in_threadpool(piece.__enter__)
    try:
        try:
            await _receive(request, piece)
        except (ClientDisconnect, TimeoutError) as interruption:
            await run_in_threadpool(piece.interrupted)
            return _answer_to(interruption)
        return await run_in_threadpool(piece.finish)
    finally:
        with anyio.CancelScope(shield=True):
            await run_in_threadpool(piece.__exit__, None, None, None)


def _is_piece(content_type: str) -> bool:
    return content_type.split(";")[0].strip().lower() == UPLOAD_CONTENT_TYPE


async def _receive(request: Request, piece: Piece) -> None:
    """Pump the body into the upload, a bounded block at a time.

    Raises:
        ClientDisconnect, TimeoutError: there will be no more; what came is written.
    """
    block = bytearray()
    try:
        async for chunk in _unless_idle(request.stream()):
            block += chunk
            if len(block) >= _BLOCK:
                await run_in_threadpool(piece.write, bytes(block))
                block.clear()
    except (ClientDisconnect, TimeoutError):
        await run_in_threadpool(piece.write, bytes(block))
        raise
    await run_in_threadpool(piece.write, bytes(block))


def _answer_to(interruption: ClientDisconnect | TimeoutError) -> Response:
    if isinstance(interruption, ClientDisconnect):
        return Response(status_code=400)  # nobody is there to read it
    return problem(UploadStalled(f"no byte came for {_IDLE_S:g} s"), headers={"Connection": "close"})


async def _unless_idle(chunks: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """The chunks as they come. Raises TimeoutError when none comes for too long."""
    while True:
        with anyio.fail_after(_IDLE_S):
            try:
                chunk = await anext(chunks)
            except StopAsyncIteration:
                return
        yield chunk


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
        except ValueError:
            raise InputError(f"Upload-Metadata: {key!r} is not base64 of UTF-8", hint="See https://tus.io.") from None
    return metadata


def parse_checksum(header: str) -> Checksum:
    """``Upload-Checksum`` as tus writes it.

    Raises:
        UnknownChecksum: it is not that.
    """
    algorithm, _, encoded = header.partition(" ")
    try:
        return Checksum(algorithm, base64.b64decode(encoded, validate=True))
    except ValueError:
        raise UnknownChecksum("Upload-Checksum is not an algorithm and base64") from None


def _request(length: int, header: str) -> UploadRequest:
    metadata = parse_metadata(header)
    try:
        purpose = Purpose(metadata.get("purpose", "recording"))
    except ValueError:
        raise InputError(
            f"no purpose {metadata['purpose']!r}", hint=f"Use one of {', '.join(purpose.value for purpose in Purpose)}."
        ) from None
    if any("\0" in value for value in metadata.values()):
        raise InputError("Upload-Metadata: a value has a NUL in it", hint="Leave it out.")
    if "site" not in metadata:
        raise InputError("Upload-Metadata names no site", hint="Send the site's id as 'site'.")
    camera, filename = metadata.get("camera", ""), nfc(metadata.get("filename", ""))
    started_ns = parse_time(metadata["started_at"]) if "started_at" in metadata else None
    return UploadRequest(metadata["site"], purpose, camera, filename, length, header, started_ns)


def _check_version(version: str) -> None:
    if version != TUS_VERSION:
        raise TusVersionMismatch(f"this is tus {TUS_VERSION}, not {version or 'an unnamed version'}")


def _expires(upload: Upload) -> str:
    return formatdate(upload.expires_at, usegmt=True)
