"""The pages' addresses. A page is a shell with ids in it: its script asks the API for everything that it shows."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.staticfiles import StaticFiles

from api.problems import documented
from api.security import CrossSite
from api.services import ServicesDep
from api.sessions import PAGE_HEADER, SESSION_COOKIE, SESSION_LIFETIME_S, share_cookie
from api.web.scripts import imported_scripts
from wibam_core import __version__
from wibam_core.adapters.settings import token_digest
from wibam_core.errors import Unauthorised

router = APIRouter(include_in_schema=False)
session_router = APIRouter(tags=["system"])
STATIC = StaticFiles(packages=[("api.web", "static")])
#: Scripts, styles and pictures come from the service alone, and nothing is written into a page that would run.
_CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "font-src 'self'; media-src 'self' blob:; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": _CSP,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_templates = Environment(loader=PackageLoader("api.web"), autoescape=True, undefined=StrictUndefined)
Id = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,79}$")]


class _Away(Exception):
    """A browser is to go elsewhere first."""

    def __init__(self, url: str) -> None:
        self.url = url


class TokenIn(BaseModel):
    """The API token, to sign in with."""

    model_config = ConfigDict(extra="forbid")

    token: str = Field(max_length=1000)


def _signed_in(request: Request, services: ServicesDep) -> None:
    """Raises:
    _Away: the browser has yet to show the token.
    """
    if not services.passes.is_session(request.cookies):
        raise _Away(f"/sign-in?next={request.url.path}")


def _may_read(job_id: str, request: Request, services: ServicesDep) -> bool:
    """Whether the browser may only read the job.

    Raises:
        _Away: it may not even do that.
    """
    passes = services.passes
    if passes.is_session(request.cookies):
        return False
    if passes.may_read(job_id, request.cookies):
        return True
    raise _Away(f"/sign-in?next={request.url.path}")


SignedIn = [Depends(_signed_in)]
ReadOnly = Annotated[bool, Depends(_may_read)]


async def go_away(request: Request, error: Exception) -> Response:
    """Answers `_Away`: the handler of the application."""
    assert isinstance(error, _Away)
    return RedirectResponse(error.url, 303, headers={"Cache-Control": "no-store"})


def add_pages(app: Any) -> None:
    """Give an application its pages."""
    app.include_router(session_router)
    app.include_router(router)
    app.mount("/static", STATIC, name="static")
    app.add_exception_handler(_Away, go_away)


def page(template: str, *, read_only: bool = False, status: int = 200, **facts: str) -> HTMLResponse:
    """A page.

    Args:
        template: its name, without ending; the page's script has the same.
        read_only: show nothing that would change something.
        status: of the answer.
        facts: what the script is told, as ``data-`` attributes of the body: ids.
    """
    html = _templates.get_template(f"{template}.html.j2").render(
        page=template,
        version=__version__,
        read_only=read_only,
        facts=facts,
        imported_scripts=imported_scripts,
    )
    return HTMLResponse(html, status, headers=_HEADERS)


# --- signing in --------------------------------------------------------------------------------
@session_router.post("/session", status_code=204, summary="Sign a browser in", responses=documented(401, 403, 422))
def sign_in(body: TokenIn, request: Request, response: Response, services: ServicesDep) -> None:
    """Gives a cookie that stands in for the token, for a week, in requests of our own pages."""
    _only_from_our_pages(request)
    if token_digest(body.token.strip()) != services.settings.token_sha256:
        raise Unauthorised("this is not the token", hint="`wibam serve` prints it; it is in the data folder, too.")
    response.set_cookie(
        SESSION_COOKIE,
        services.passes.session(),
        max_age=int(SESSION_LIFETIME_S),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )


@session_router.delete("/session", status_code=204, summary="Sign a browser out", responses=documented(403))
def sign_out(request: Request, response: Response) -> None:
    """Takes the cookie away."""
    _only_from_our_pages(request)
    response.delete_cookie(SESSION_COOKIE, httponly=True, samesite="strict", secure=request.url.scheme == "https")


def _only_from_our_pages(request: Request) -> None:
    if PAGE_HEADER not in request.headers:
        raise CrossSite(f"the header {PAGE_HEADER} is missing")


@router.get("/sign-in")
def sign_in_page(request: Request, services: ServicesDep) -> Response:
    if services.passes.is_session(request.cookies):
        return RedirectResponse("/jobs", 303)
    return page("sign_in")


@router.get("/docs")
def docs() -> HTMLResponse:
    """For whoever has no token, too: it says how to use one."""
    return page("docs")


@router.get("/share/{job_id}")
def shared(job_id: Id, services: ServicesDep, request: Request, key: str = "") -> Response:
    """Trades a link (`POST /v1/jobs/{job_id}/share-link`) for a cookie, so that the key does not stay in addresses."""
    passes = services.passes
    if not passes.is_share(job_id, key):
        return page("expired", status=401)
    response = RedirectResponse(f"/jobs/{job_id}", 303)
    response.set_cookie(
        share_cookie(job_id),
        key,
        max_age=int(passes.remaining_s(key)),
        httponly=True,
        samesite="lax",  # the link is followed from a mail, which "strict" takes for another site
        secure=request.url.scheme == "https",
    )
    return response


# --- pages -------------------------------------------------------------------------------------
@router.get("/")
def start() -> RedirectResponse:
    return RedirectResponse("/jobs", 303)


@router.get("/jobs", dependencies=SignedIn)
def jobs() -> HTMLResponse:
    return page("jobs")


@router.get("/jobs/{job_id}")
def job(job_id: Id, read_only: ReadOnly) -> HTMLResponse:
    return page("job", read_only=read_only, job=job_id)


@router.get("/jobs/{job_id}/preflight")
def preflight(job_id: Id, read_only: ReadOnly) -> HTMLResponse:
    return page("preflight", read_only=read_only, job=job_id)


@router.get("/jobs/{job_id}/instants")
def instants(job_id: Id, read_only: ReadOnly) -> HTMLResponse:
    return page("instants", read_only=read_only, job=job_id)


@router.get("/jobs/{job_id}/results")
def results(job_id: Id, read_only: ReadOnly) -> HTMLResponse:
    return page("results", read_only=read_only, job=job_id)


@router.get("/models", dependencies=SignedIn)
def models() -> HTMLResponse:
    return page("models")


@router.get("/compare", dependencies=SignedIn)
def compare() -> HTMLResponse:
    return page("compare")


@router.get("/keys", dependencies=SignedIn)
def keys() -> HTMLResponse:
    return page("keys")


@router.get("/sites", dependencies=SignedIn)
def sites() -> HTMLResponse:
    return page("sites")


@router.get("/sites/{site_id}", dependencies=SignedIn)
def site(site_id: Id) -> HTMLResponse:
    return page("site", site=site_id)


@router.get("/sites/{site_id}/cameras/{camera_id}", dependencies=SignedIn)
def camera(site_id: Id, camera_id: Id) -> HTMLResponse:
    return page("camera", site=site_id, camera=camera_id)


@router.get("/jobs/{job_id}/player")
def player(job_id: Id, read_only: ReadOnly) -> HTMLResponse:
    return page("player", read_only=read_only, job=job_id)


@router.get("/jobs/{job_id}/conflicts")
def conflicts(job_id: Id, read_only: ReadOnly) -> HTMLResponse:
    return page("conflicts", read_only=read_only, job=job_id)


@router.get("/jobs/{job_id}/labelling")
def labelling(job_id: Id, read_only: ReadOnly) -> HTMLResponse:
    return page("labelling", read_only=read_only, job=job_id)
