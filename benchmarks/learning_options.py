"""What the benchmarks of learning share on the command line: sites, files of rows, and what to type for them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.learning_rows import Row, RowFile, Run
from benchmarks.learning_sites import Site, make_site


def site_parser(description: str | None, *, sites: list[int], seconds: float) -> argparse.ArgumentParser:
    """Options that all have: which sites, and what is done with the rows that were made before."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=int, nargs="+", default=sites)
    parser.add_argument("--seconds", type=float, default=seconds)
    parser.add_argument("--density", type=float, default=1.2)
    parser.add_argument("--width-px", type=int, default=1280, help="of the recordings, which are 16:9")
    parser.add_argument("--fresh", action="store_true", help="forget the rows that were made before")
    parser.add_argument("--keep", action="store_true", help="take rows that other versions of the code made, too")
    parser.add_argument("--cache", type=Path, default=Path("build/learning"))
    parser.add_argument("--out", type=Path, default=Path("build/learning"))
    return parser


def recording_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """What is recorded at each site: length in s, density of the traffic, width of the images in px."""
    return {"seconds": arguments.seconds, "density": arguments.density, "width_px": arguments.width_px}


def made_rows(
    arguments: argparse.Namespace,
    name: str,
    runs: Iterable[Run],
    figures: Callable[[Site, Run], Mapping[str, Any]],
) -> Iterator[Row]:
    """The rows of runs, in order, each as soon as it is in ``name.json``; sites are made when they are needed."""

    @cache
    def site_of(number: int) -> Site:
        network = getattr(arguments, "network", None)
        return make_site(number, **recording_of(arguments), cache=arguments.cache, network=network)

    file = RowFile(arguments.out / f"{name}.json", fresh=arguments.fresh, keep=arguments.keep)
    return file.rows(runs, lambda run: figures(site_of(run["site"]), run))


def command_of(module: str, **options: Any) -> str:
    """What to type to run a benchmark: lists are written out, switches that are off and None left out."""
    words = [f"python -m benchmarks.{module}"]
    for name, value in options.items():
        if value is None or value is False:
            continue
        words.append(f"--{name.replace('_', '-')}")
        if value is not True:
            words += [_typed(one) for one in (value if isinstance(value, list | tuple) else [value])]
    return " ".join(words)


def _typed(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
