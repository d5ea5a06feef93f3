"""Which sites were looked at while the method was chosen, by ``looks.json``: documents with figures of a site say so.

An entry has the names of its sites (numbers of simulated ones), whether anything was chosen by what they showed, and
what. Whoever looks at a site before deciding something adds it there.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_FILE = Path(__file__).with_name("looks.json")


@dataclass(frozen=True)
class Look:
    """Sites that were looked at.

    Attributes:
        sites: their names.
        kind: "simulated" or "real".
        chosen: whether something was chosen by what they showed, so that their figures flatter it.
        what: that, a sentence for a reader.
    """

    sites: tuple[str, ...]
    kind: str
    chosen: bool
    what: str


@cache
def looks() -> tuple[Look, ...]:
    """All entries."""
    rows = json.loads(_FILE.read_text(encoding="utf-8"))
    return tuple(Look(tuple(row["sites"]), row["kind"], row["chosen"], row["what"]) for row in rows)


def chosen_on(site: str | int) -> bool:
    """Whether something was chosen by what the site showed."""
    return any(look.chosen and str(site) in look.sites for look in looks())


def said_of(sites: Iterable[str | int]) -> str:
    """What a reader of figures of these sites should know of earlier looks at them: sentences."""
    names: Sequence[str] = list(dict.fromkeys(map(str, sites)))
    said = []
    for look in looks():
        if own := [name for name in names if name in look.sites]:
            flatters = ", so that its figures flatter" if len(own) == 1 else ", so that their figures flatter"
            verb = f"Chosen on{flatters}" if look.chosen else "Looked at before"
            said.append(f"{verb}: {', '.join(own)}. {look.what}")
    seen = {name for look in looks() for name in look.sites}
    if unseen := [name for name in names if name not in seen]:
        said.append(f"Not looked at before: {', '.join(unseen)}.")
    return " ".join(said) + " (`benchmarks/looks.json`)" if said else ""
