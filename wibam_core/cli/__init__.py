"""`wibam`: the command line."""

from __future__ import annotations

import os
import sys

from rich.console import Console
from rich.markup import escape

from wibam_core.adapters.threads import waiting
from wibam_core.errors import WibamError


def main() -> None:
    """Run the command line; an error that a person can act on is one sentence and a hint, not a traceback."""
    os.environ |= waiting(os.environ)
    from wibam_core.cli.app import app

    try:
        app(standalone_mode=True)
    except WibamError as error:
        console = Console(stderr=True)
        console.print(f"[red]{escape(error.message)}[/] [dim]({error.code})[/]", highlight=False, soft_wrap=True)
        if error.hint:
            console.print(escape(error.hint), highlight=False, soft_wrap=True)  # commands in it can be copied
        sys.exit(1)
