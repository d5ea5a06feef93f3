"""Which scripts a page needs beyond those that it names: what they import, and what that imports."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from posixpath import dirname, join, normpath

#: An import or re-export of another script of ours, at the beginning of a line. Types in comments are none.
_IMPORT = re.compile(r'^(?:import|export)\s+(?:[^"=();]*\sfrom\s+)?"(\.{1,2}/[^"]+)"', re.MULTILINE)


@cache
def imported_scripts(*paths: str) -> tuple[str, ...]:
    """Scripts that some import, directly or not, the nearest first.

    A browser meets an import only once it has read the script that has it, so that a chain of four costs four round
    trips. Where the page names them all, they are asked for at once.

    Args:
        paths: of the scripts, from the folder of the static files: ``js/pages/player.js``.

    Returns:
        Paths of the same kind, each once, without those given.
    """
    found = list(paths)
    for script in found:  # which grows meanwhile
        text = files("api.web").joinpath("static", script).read_text("utf-8")
        for name in _IMPORT.findall(text):
            imported = normpath(join(dirname(script), name))
            if imported not in found:
                found.append(imported)
    return tuple(found[len(paths) :])
