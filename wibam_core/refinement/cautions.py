"""What a person should know of a refined calibration. Nothing here needs torch, which takes seconds to import."""

from __future__ import annotations

from wibam_core.documents.refinement import RefinedCamera, Refinement
from wibam_core.documents.warnings import Caution

#: A clock that seems to be off by more than this is worth a word, ms. True ones of a real site seem to be by 31.
_LATE_MS = 40.0


def cautions_of(refinement: Refinement) -> list[Caution]:
    """That cameras were changed, and whose clock seems to be off."""
    late = {name: camera for name, camera in refinement.cameras.items() if abs(camera.late_ms) > _LATE_MS}
    changed = [_changed(refinement)] if refinement.taken else []
    return changed + [_late(name, camera) for name, camera in late.items()]


def _changed(refinement: Refinement) -> Caution:
    cameras = refinement.cameras
    by_camera = ", ".join(f"{name} by {one.turned_deg:.2f}° and {one.moved_m:.2f} m" for name, one in cameras.items())
    return Caution(
        code="calibration_refined",
        message=f"Road users that several cameras see contradict the calibration, which was corrected: {by_camera}; "
        f"{refinement.reason}",
        hint="Check the points of the calibration, and whether a camera was moved after they were taken; with "
        "refine.method=none it is used as it was given.",
        details={name: {"turned_deg": one.turned_deg, "moved_m": one.moved_m} for name, one in cameras.items()},
    )


def _late(camera_id: str, camera: RefinedCamera) -> Caution:
    return Caution(
        code="clock_contradicted",
        message=f"Camera {camera_id}: by the ways of the vehicles, its clock is off by {camera.late_ms:.0f} ms from "
        "what synchronisation says",
        hint="Look at the light changes that it was synchronised by.",
        details={"camera": camera_id, "late_ms": camera.late_ms},
    )
