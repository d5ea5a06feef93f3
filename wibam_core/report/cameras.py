"""What cameras see together, and what the traffic said of their calibration, in words and tables."""

from __future__ import annotations

from wibam_core.documents.calibration import Overlap
from wibam_core.documents.refinement import Refinement
from wibam_core.report.words import NONE, number, percent, signed


def overlap_rows(overlap: Overlap | None) -> tuple[tuple[str, ...], ...]:
    """Of each pair of cameras: which, the road that both see (m²), and its share of what one of them sees."""
    pairs = () if overlap is None else overlap.pairs
    return tuple((" and ".join(pair.cameras), number(pair.area_m2, 0), percent(pair.share)) for pair in pairs)


def overlap_text(overlap: Overlap | None) -> str:
    """How much of the road so many cameras see."""
    if overlap is None or len(overlap.area_m2) < 2:
        return ""
    areas = ", ".join(
        f"{area:.0f} m² by {'one camera' if count == '1' else f'{count} cameras'} or more"
        for count, area in overlap.seen_by_m2.items()
    )
    where = f"Within {overlap.within_m:.0f} m of the middle of the cameras"
    return f"{where} the road is seen, were nothing in the way: {areas}."


def refinement_text(refinement: Refinement) -> str:
    """What became of the calibration, and where the road was found."""
    if not refinement.cameras:
        return f"Cameras are as they were calibrated: {refinement.reason}."
    change = "Cameras were corrected by the traffic" if refinement.taken else "Cameras are as they were calibrated"
    said = f"{change}, by {refinement.vehicles} vehicles: {refinement.reason}."
    ground = refinement.ground
    if ground is None or not refinement.taken:
        return said
    slope = 100 * (ground.slope_x**2 + ground.slope_y**2) ** 0.5
    return (
        f"{said} The road lies {signed(ground.height_m, 2)} m from where the calibration had it, with a slope of "
        f"{slope:.1f} % against it; heights count from it now."
    )


def refined_rows(refinement: Refinement) -> tuple[tuple[str, ...], ...]:
    """Of each camera by how much it was, or would have been, turned (°), moved (m), and is late by its clock (ms)."""
    return tuple(
        (
            name,
            number(camera.turned_deg, 2),
            number(camera.moved_m, 2),
            NONE if camera.focal_change is None else signed(100 * camera.focal_change, 1),
            signed(camera.late_ms, 0),
        )
        for name, camera in refinement.cameras.items()
    )
