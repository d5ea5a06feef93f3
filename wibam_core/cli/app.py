"""The commands of `wibam`, each a module of this package."""

from __future__ import annotations

import typer

from wibam_core.cli import jobs, weights
from wibam_core.cli.demo import demo
from wibam_core.cli.detect import detect
from wibam_core.cli.export import export
from wibam_core.cli.importing import import_data
from wibam_core.cli.run import run
from wibam_core.cli.serve import serve
from wibam_core.cli.signals import signals
from wibam_core.cli.simulate import simulate
from wibam_core.cli.sites import sites
from wibam_core.cli.track import track
from wibam_core.cli.tracks import tracks
from wibam_core.cli.upload import upload

app = typer.Typer(
    name="wibam",
    help="Fine-tune a monocular 3D vehicle detector for your intersection, without hand labels.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
for command in (demo, run, serve, upload, sites, tracks, export, simulate, detect, signals, track):
    app.command()(command)
app.command("import")(import_data)
app.add_typer(jobs.app, name="jobs")
app.add_typer(weights.app, name="weights")
