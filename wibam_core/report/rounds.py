"""What rounds of finding, fitting and teaching gained, for a person."""

from __future__ import annotations

from collections.abc import Mapping

from wibam_core.documents.rounds import Rounds, Source
from wibam_core.report.words import NONE, number, percent

_SOURCES: Mapping[Source, str] = {"detector": "detector", "motion": "what moves", "network": "taught network"}
#: Titles of the cells of `round_rows`, after the round's number and source.
ROUND_TITLES = (
    "boxes an image",
    "vehicles an instant, in several views",
    "held-out views: found",
    "IoU where found",
    "IoU summed, an instant",
    "vehicles that taught",
)


def round_rows(rounds: Rounds) -> tuple[tuple[str, ...], ...]:
    """A row a round: number and source, which say whether it was kept, and cells for `ROUND_TITLES`; none without."""
    if len(rounds.rounds) < 2:
        return ()
    return tuple(
        (
            f"{one.number}: {_SOURCES[one.source]}{' (kept)' if one.number == rounds.kept else ''}",
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
        return f"Nothing else looked for what the detector overlooked: {rounds.reason}."
    left_out = sum(one.scenery_left_out or 0 for one in rounds.rounds if one.number <= rounds.kept)
    scenery = (
        f" Of the detector's boxes {left_out} lie on what never changes and were left out, since other cameras mostly "
        "have none of the same."
    )
    return (
        "What the detector overlooked was looked for by what moves beside the still backgrounds, and by networks that "
        "what several cameras see had taught. Each camera's boxes were compared with vehicles that the others place, "
        f"at instants that neither taught nor test. Round {rounds.kept} is kept: {rounds.reason}."
        + (scenery if left_out else "")
    )
