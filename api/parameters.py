"""Query parameters that a route does not have are refused: one that is misspelt would otherwise change nothing."""

from __future__ import annotations

from fastapi import Depends, Request
from fastapi.dependencies.models import Dependant

from wibam_core.errors import InputError


def _only_known(request: Request) -> None:
    """Raises:
    InputError: naming the first parameter that the route does not have.
    """
    known = _aliases(request.scope["route"].dependant)
    for name in request.query_params:
        if name not in known:
            raise InputError(
                f"there is no parameter {name!r}", hint=f"The parameters are {', '.join(known)}.", parameter=name
            )


def _aliases(dependant: Dependant) -> list[str]:
    """Those of a route, and of what it depends on."""
    below = [alias for dependency in dependant.dependencies for alias in _aliases(dependency)]
    return [*below, *(field.alias for field in dependant.query_params)]


#: For the ``dependencies`` of a route.
ONLY_KNOWN_PARAMETERS = Depends(_only_known)
