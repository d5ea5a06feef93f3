"""The commands of `wibam`, each in a module of this package.

A command's module is imported once somebody runs the command or asks for its help, not before: some need seconds for
that. The list of all commands takes their sentences from the modules' source.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from wibam_core import __version__

if TYPE_CHECKING:
    from typer._click.core import Command, Context

#: In the order of the list: what a person types -> the module and its function, or its `app` of several commands.
COMMANDS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        **{name: (name, name) for name in ("demo", "run", "serve", "upload", "sites", "tracks", "clip", "export")},
        "import": ("importing", "import_data"),
        "calibration": ("calibration", "calibration"),
        **{name: (name, name) for name in ("simulate", "detect", "signals", "track", "watch")},
        **{name: (name, "app") for name in ("jobs", "keys", "labels", "models", "webhooks", "weights")},
    }
)


def load(name: str) -> Command:
    """A command with its options."""
    module, attribute = COMMANDS[name]
    found = getattr(importlib.import_module(f"wibam_core.cli.{module}"), attribute)
    if isinstance(found, typer.Typer):
        command: Command = typer.main.get_group(found)
    else:
        alone = typer.Typer(add_completion=False)
        alone.command()(found)
        command = typer.main.get_command(alone)
    command.name = name
    return command


def summary(name: str) -> str:
    """What a command does: the docstring of its function, or the help of its `app`; its module is only read."""
    module, attribute = COMMANDS[name]
    tree = ast.parse((Path(__file__).parent / f"{module}.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and node.name == attribute:
            return (ast.get_docstring(node) or "").partition("\n\n")[0]
        if (
            isinstance(node, ast.Assign)
            and ast.unparse(node.targets[0]) == attribute
            and isinstance(node.value, ast.Call)
        ):
            words: Mapping[str | None, Any] = {word.arg: word.value for word in node.value.keywords}
            return str(ast.literal_eval(words["help"]))
    raise ValueError(f"the module {module} has no {attribute}")


class _LateCommands(TyperGroup):
    """Knows its commands by their names and sentences until one is asked for."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = {name: TyperCommand(name, help=summary(name)) for name in COMMANDS}

    def resolve_command(self, ctx: Context, args: list[str]) -> tuple[str | None, Command | None, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        return name, load(name) if name is not None and command is not None else command, rest


app = typer.Typer(
    name="wibam",
    cls=_LateCommands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


def _say_version(asked_for: bool) -> None:
    if asked_for:
        typer.echo(f"wibam {__version__}")
        raise typer.Exit


@app.callback()
def wibam(
    version: Annotated[
        bool, typer.Option("--version", callback=_say_version, is_eager=True, help="Say which version this is.")
    ] = False,
) -> None:
    """Fine-tune a monocular 3D vehicle detector for your intersection, without hand labels."""
