"""Which files a site takes."""

from __future__ import annotations

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from wibam_core.adapters.models import FileRow, UploadRow
from wibam_core.errors import InputError, QuotaExceeded, TooLarge
from wibam_core.jobs.records import Purpose
from wibam_core.site import Site, SiteCamera

#: A picture of an intersection at 5 cm a pixel has a few megabytes.
LARGEST_MAP_BYTES = 100_000_000


def check_camera(site: Site, purpose: Purpose, camera_id: str) -> None:
    if not purpose.is_of_camera:
        if camera_id:
            raise InputError(
                f"a file for {purpose} belongs to the site, not to camera {camera_id!r}", hint="Leave the camera out."
            )
    elif camera_id not in site.camera_ids:
        raise InputError(
            f"the site has no camera {camera_id!r}",
            hint=f"Its cameras are {', '.join(site.camera_ids)}.",
            camera=camera_id,
        )


def camera_of(site: Site, camera_id: str) -> SiteCamera | None:
    return next((camera for camera in site.cameras if camera.id == camera_id), None)


def check_listed(camera: SiteCamera | None, filename: str) -> None:
    if camera is not None and camera.recordings and filename not in camera.recordings:
        raise InputError(
            f"the site lists no file {filename!r} for camera {camera.id}",
            hint=f"It lists {', '.join(camera.recordings)}: describe the site anew to add one.",
            camera=camera.id,
        )


def retire_unlisted(session: Session, site_id: str, camera: SiteCamera, now: float) -> None:
    """Take those files of a camera off its site that its list does not name, and, where it has none, all of several."""
    current = (
        (FileRow.site_id == site_id)
        & (FileRow.purpose == Purpose.RECORDING.value)
        & (FileRow.camera_id == camera.id)
        & FileRow.retired_at.is_(None)
    )
    if camera.recordings:
        current &= FileRow.filename.not_in(camera.recordings)
    elif (session.scalar(select(func.count()).select_from(FileRow).where(current)) or 0) < 2:
        return
    session.execute(update(FileRow).where(current).values(retired_at=now))


def check_size(purpose: Purpose, length: int) -> None:
    if purpose is Purpose.MAP and length > LARGEST_MAP_BYTES:
        raise TooLarge(
            f"the picture has {length / 1e6:.0f} MB; a map may have {LARGEST_MAP_BYTES / 1e6:.0f} MB",
            hint="Cut out the intersection, or save it smaller; the world file of a cut-out keeps it in place.",
        )


def check_quota(session: Session, length: int, quota_bytes: int) -> None:
    stored = session.scalar(select(func.coalesce(func.sum(FileRow.size_bytes), 0))) or 0
    promised = session.scalar(
        select(func.coalesce(func.sum(UploadRow.length_bytes), 0)).where(UploadRow.file_id.is_(None))
    )
    used = int(stored) + int(promised or 0)
    if used + length > quota_bytes:
        raise QuotaExceeded(
            f"{length / 1e6:.0f} MB are too many: {used / 1e6:.0f} of {quota_bytes / 1e6:.0f} MB are taken",
            hint="Delete recordings that are no longer needed, or raise the service's upload quota.",
            used_bytes=used,
            quota_bytes=quota_bytes,
        )
