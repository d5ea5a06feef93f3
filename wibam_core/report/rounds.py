"""What rounds of finding, fitting and teaching gained, for a person."""

from __future__ import annotations

from wibam_core.documents.rounds import Rounds
from wibam_core.report.words import NONE, number, percent

#: Titles of the cells of `round_rows`, after the round's number.
ROUND_TITLES = (
    "boxes an image",
    "vehicles an instant, in several views",
    "held-out views: found",
    "IoU where found",
    "IoU summed, an instant",
    "vehicles that taught",
)


def round_rows(rounds: Rounds) -> tuple[tuple[str, ...], ...]:
    """A row a round: its number, which says whether it was kept, and cells for `ROUND_TITLES`; none without rounds."""
    if len(rounds.rounds) < 2:
        return ()
    return tuple(
        (
            f"{one.number}{' (kept)' if one.number == rounds.kept else ''}",
            number(sum(one.boxes_an_image.values()) / max(len(one.boxes_an_image), 1), 1),
            number(sum(count for views, count in one.vehicles_an_instant.items() if int(views) > 1), 2),
            percent(one.agreement.found),
            number(one.agreement.iou, 2),
            number(one.agreement.an_instant, 2),
            NONE if one.taught_vehicles is None else str(one.taught_vehicles),
        )
        for one in rounds.rounds
    )


def rounds_text(rounds: Rounds) -> str:
    """What the rows show, or why no round was run; nothing where none was thought of."""
    if not rounds.rounds:
        return ""
    if len(rounds.rounds) == 1:
        return f"No network was taught to look for what the detector overlooked: {rounds.reason}."
    return (
        "What several cameras see taught a network, which looked for what the detector overlooked; round 0 is what it "
        "found. Each camera's boxes were compared with vehicles that the others place, at instants that neither taught "
        f"nor test. Round {rounds.kept} is kept: {rounds.reason}."
    )
