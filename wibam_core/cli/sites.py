"""`wibam sites`: the sites that a service has."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from wibam_core.cli.display import list_table, print_list
from wibam_core.cli.service import DEFAULT_URL, Token, Url, connect
from wibam_core.jobs.records import Purpose


def sites(url: Url = DEFAULT_URL, token: Token = "") -> None:
    """List the sites of a service, the newest first: id, how many cameras have a recording, name.

    `wibam upload DIR --site ID` sends what is missing of one.
    """
    table = list_table("site", others=("cameras", "recordings", "name"))
    with connect(url, token) as client:
        for site in client.sites():
            recordings = sum(1 for file in client.files(site.id) if file.purpose is Purpose.RECORDING)
            table.add_row(site.id, str(len(site.cameras)), str(recordings), escape(site.name))
    print_list(Console(), table)
