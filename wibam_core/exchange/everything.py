"""All that there is, in every format that it allows, and our own files: a folder each, and a README on all of them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from wibam_core.errors import InputError
from wibam_core.exchange.base import Content, ExchangeFormat, Part

#: The folder of our own files; no format has this name.
_OWN_FOLDER = "wibam"
#: Files of a format that the README lists: some formats write a file a frame.
_SHOWN_FILES = 20


class Everything:
    """The format, for the registry.

    Args:
        formats: those that are tried.
    """

    name = "everything"
    title = "Everything, in all formats"
    needs = frozenset[Part]()
    loses = "Frames and recordings. What each format loses is said in the README beside the files."

    def __init__(self, formats: Sequence[ExchangeFormat]) -> None:
        self._formats = formats
        self.writes = frozenset[Part]().union(*(fmt.writes for fmt in formats)) - {Part.FRAMES, Part.ORIGIN}

    def write(self, content: Content, folder: Path) -> Iterator[Path]:
        """Write a folder for each format that the content allows, our own files, and ``README.md``, one by one.

        Raises:
            InputError: it allows none.
        """
        written: list[str] = []
        left_out: list[str] = []
        for fmt in self._formats:
            (folder / fmt.name).mkdir()
            try:
                paths = list(fmt.write(content, folder / fmt.name))
            except InputError as error:
                shutil.rmtree(folder / fmt.name)
                left_out.append(f"- {error.message}. {error.hint}")
                continue
            written.append(_section(fmt.title, [path.relative_to(folder) for path in paths], f"Lost: {fmt.loses}"))
            yield from paths
        if not written:
            raise InputError(
                "there is nothing yet that any format holds", hint="Let the job run up to the calibration at least."
            )
        if content.files:
            names = [Path(_OWN_FOLDER) / name for name in content.files]
            written.append(_section("WIBAM's own files", names, "Nothing is lost."))
            for name, path in zip(names, content.files.values(), strict=True):
                yield _copied(path, folder / name)
        title = content.site.name if content.site else "A site"
        closing = ["## Left out", "", *left_out] if left_out else []
        readme = folder / "README.md"
        readme.write_text("\n".join([f"# {title}", "", *written, *closing]).rstrip() + "\n", encoding="utf-8")
        yield readme


def _section(title: str, files: Sequence[Path], note: str) -> str:
    shown = [str(file) for file in files[:_SHOWN_FILES]]
    if len(files) > _SHOWN_FILES:
        shown.append(f"... and {len(files) - _SHOWN_FILES} more")
    return "\n".join([f"## {title}", "", *(f"- {file}" for file in shown), "", note, ""])


def _copied(path: Path, to: Path) -> Path:
    to.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, to)
    return to
