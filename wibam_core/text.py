"""Text files as editors and spreadsheets save them, on any system."""

from __future__ import annotations

import codecs
import json
import unicodedata
from typing import Any

#: UTF-32's little-endian mark begins with UTF-16's, so that it is asked for first.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
#: How much of a file shows how it is encoded where it has no mark.
_LOOKED_AT = 512


def nfc(text: str) -> str:
    """The text in Unicode's composed form (NFC): macOS keeps names of files with accents apart from their letters."""
    return unicodedata.normalize("NFC", text)


class NotUnicode(ValueError):
    """A file that is no text in a Unicode encoding; the message says what it looks like."""


def decode_text(content: bytes) -> str:
    """The text of a file in UTF-8, UTF-16 or UTF-32, with or without a byte-order mark, which is left out.

    Raises:
        NotUnicode: it is in another encoding, or no text.
    """
    mark, encoding = next(
        ((mark, encoding) for mark, encoding in _MARKS if content.startswith(mark)), (b"", _unmarked(content))
    )
    try:
        return content[len(mark) :].decode(encoding)
    except UnicodeDecodeError as error:
        if b"\0" in content[:_LOOKED_AT] or mark:
            raise NotUnicode("it is no text") from error
        where = error.start
        line = content.count(b"\n", 0, where) + 1
        raise NotUnicode(
            f"it is not in UTF-8 but in an older encoding, such as Windows-1252: line {line} has the byte "
            f"{content[where]:#04x}"
        ) from error


class NotJson(ValueError):
    """A text that is no JSON, or says one thing twice; the message says where and why."""


def read_json(text: str) -> Any:
    """What a JSON text holds. A name that an object has twice is refused: nobody could say which was meant.

    Raises:
        NotJson: it is none.
    """
    try:
        return json.loads(text, object_pairs_hook=_only_once)
    except json.JSONDecodeError as error:
        line = text.split("\n")[error.lineno - 1].strip()
        raise NotJson(f"line {error.lineno}, column {error.colno}: {_why(text, error)}: {line[:60]}") from error
    except RecursionError as error:
        raise NotJson("it is nested too deeply") from error
    except ValueError as error:
        if isinstance(error, NotJson):
            raise
        raise NotJson(f"it has a number that is too long: {error}") from error  # of more digits than Python reads


def _only_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise NotJson(f"an object has {name[:60]!r} twice; leave out the one that is not meant")
        found[name] = value
    return found


def _why(text: str, error: json.JSONDecodeError) -> str:
    rest, before = text[error.pos :].lstrip(), text[: error.pos].rstrip()
    if rest.startswith(("//", "/*", "#")):
        return "JSON has no comments"
    if (rest.startswith(("}", "]")) and before.endswith(",")) or (rest.startswith(",") and "trailing" in error.msg):
        return "a comma too many"
    if rest.startswith("'"):
        return "JSON has double quotes alone"
    return error.msg


def _unmarked(content: bytes) -> str:
    """The encoding of a file without a mark, whose first characters are taken to be ASCII, as in JSON and CSV."""
    first = content[:_LOOKED_AT]
    if b"\0" not in first:
        return "utf-8"
    even, odd = first[0::2].count(0), first[1::2].count(0)
    if first[:3] == b"\0\0\0" or first[1:4] == b"\0\0\0":
        return "utf-32-be" if first[0] == 0 else "utf-32-le"
    return "utf-16-be" if even > odd else "utf-16-le"
