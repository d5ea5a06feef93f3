"""How much a JSON body may hold, judged by counting alone, before anything looks at what it says.

A schema's errors are built one by one: of a few megabytes of empty objects it would build hundreds of thousands.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute

from api.security import BodyTooLarge
from wibam_core.errors import TooLarge
from wibam_core.text import NotJson, NotUnicode, decode_text, read_json

#: No object of a description has a tenth of this many members.
MOST_MEMBERS = 200
#: Values of all kinds, at all depths: 32 cameras with 500 surveyed points each have some 220,000.
MOST_VALUES = 300_000


class BoundedJsonRoute(APIRoute):
    """A route whose JSON body is counted first."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        handle = super().get_route_handler()

        async def bounded(request: Request) -> Response:
            return await handle(_BoundedRequest(request.scope, request.receive))

        return bounded


class _BoundedRequest(Request):
    async def json(self) -> Any:
        try:
            content = read_json(decode_text(await self.body()))
        except (NotJson, NotUnicode) as error:
            raise json.JSONDecodeError(str(error), "", 0) from error  # which FastAPI knows
        try:
            count_values(content)
        except TooLarge as error:
            raise BodyTooLarge(error) from error
        return content


def count_values(content: Any) -> None:
    """Refuse what holds too much.

    Args:
        content: parsed JSON.

    Raises:
        TooLarge: an object has more than `MOST_MEMBERS` members, or all together hold more than `MOST_VALUES` values.
    """
    values = 0
    left = [content]
    while left:
        one = left.pop()
        if isinstance(one, dict) and len(one) > MOST_MEMBERS:
            raise TooLarge(
                f"an object in the body has {len(one)} members; none that is known has more than {MOST_MEMBERS}",
                hint="/docs describes every object.",
            )
        if isinstance(one, dict | list):
            values += len(one)
            left.extend(one.values() if isinstance(one, dict) else one)
        if values > MOST_VALUES:
            raise TooLarge(
                f"the body holds more than {MOST_VALUES:,} values",
                hint="Leave out what is not needed; /docs says what is.",
            )
