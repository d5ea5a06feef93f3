"""Pages of lists. A list that goes on says where, in ``Link: <...>; rel="next"`` (RFC 8288)."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Final, TypeVar

from fastapi import Depends, Query, Request, Response

from api.addresses import address
from api.times import parse_time
from wibam_core.adapters.paging import Place, Span
from wibam_core.adapters.records import plain_text
from wibam_core.errors import InputError

T = TypeVar("T")
Key = tuple[float | int | str, ...]
#: The header that leads to the next page.
LINK: Final = "Link"
_TIME = "2026-07-01T08:00:00+02:00"
_MOST_CURSOR = 600
#: No number of a key is as large, and no infinity or NaN is smaller.
_BEYOND = 2**63


class Page:
    """The page of a list that was asked for.

    Attributes:
        limit: how many items at most.
    """

    def __init__(
        self,
        request: Request,
        response: Response,
        limit: Annotated[int, Query(ge=1, le=1000, description="how many at most")] = 100,
        cursor: Annotated[
            str | None,
            Query(max_length=_MOST_CURSOR, description='of the next page, as `Link: <...>; rel="next"` has it'),
        ] = None,
    ) -> None:
        self.limit = limit
        self._cursor = cursor
        self._request = request
        self._response = response

    @property
    def one_more(self) -> int:
        """How many to fetch: whether there is a next page is seen by the one that it begins with."""
        return self.limit + 1

    def after(self, *kinds: type) -> Key | None:
        """The key of the last item of the page before; None: this is the first page.

        Args:
            kinds: of the parts of the key.

        Raises:
            InputError: the cursor is not one of this list.
        """
        if self._cursor is None:
            return None
        try:
            found = json.loads(base64.urlsafe_b64decode(self._cursor.encode("ascii") + b"=="))
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, list) or len(found) != len(kinds) or not all(map(_is_a, found, kinds)):
            raise InputError(
                f"{self._cursor[:40]!r} is no cursor of this list",
                hint='Use the address in the header Link of the page before (rel="next").',
                parameter="cursor",
            )
        return tuple(found)

    @property
    def place(self) -> Place | None:
        """As `after`, in a list that begins with the newest."""
        key = self.after(float, str)
        return None if key is None else Place(float(key[0]), str(key[1]))

    def cut(self, found: Sequence[T], key: Callable[[T], Key]) -> Sequence[T]:
        """The items of this page, of `one_more` at most that follow the page before; says where the next begins.

        Args:
            found: in the order of the list.
            key: tells the place of an item.
        """
        if len(found) > self.limit:
            values = json.dumps(key(found[self.limit - 1]), ensure_ascii=False, separators=(",", ":")).encode()
            cursor = base64.urlsafe_b64encode(values).decode().rstrip("=")
            url = self._request.url.include_query_params(cursor=cursor)
            self._response.headers[LINK] = f'<{address(self._request, url.path)}?{url.query}>; rel="next"'
        return found[: self.limit]

    def of_all(self, items: Sequence[T], key: Callable[[T], Key], *kinds: type) -> Sequence[T]:
        """The items of this page, of a list that is at hand.

        Args:
            items: all, in any order; the list goes by their keys.
            key: of an item, no two alike.
            kinds: of the parts of a key.
        """
        after = self.after(*kinds)
        ordered = sorted(items, key=key)
        return self.cut(ordered if after is None else [item for item in ordered if key(item) > after], key)


def _is_a(value: Any, kind: type) -> bool:
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _BEYOND
    if kind is int:
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) < _BEYOND
    return isinstance(value, str) and plain_text(value) == value


#: ISO 8601 with its offset from UTC.
Time = Annotated[str | None, Query(max_length=60, examples=[_TIME])]


def _made(
    start: Annotated[Time, Query(alias="from", description="made then or later; ISO 8601 with its offset")] = None,
    end: Annotated[Time, Query(alias="to", description="made before")] = None,
) -> Span:
    return Span(*(None if text is None else parse_time(text) / 1e9 for text in (start, end)))


#: What the name or the id of an item contains.
Text = Annotated[str, Query(max_length=200, description="that the name or the id contains")]
PageDep = Annotated[Page, Depends()]
#: When the items of a list were made.
MadeDep = Annotated[Span, Depends(_made)]
