"""The application object of the command line and the one place where errors become exit codes.

0 done, 1 the answer is no, 2 usage, 65 bad data, 66 missing input, 69 unreachable, 70 internal, 74 I/O, 76 protocol,
78 configuration, 130 interrupted. Commands register themselves on `app` from the sibling modules, each of which is
loaded when one of its commands is called: the list of commands stands in `catalogue`.
"""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from daemon.circles import look_seldom
from daemon.cli.catalogue import COMMANDS, GROUPS
from daemon.cli.output import complaint, data, prepare_streams, set_verbosity, settle_stdout
from daemon.errors import EXIT_INTERNAL, EXIT_INTERRUPTED, exit_code_of, sentence_of
from daemon.signals import ends_as_interrupts


class CatalogueGroup(TyperGroup):
    """The commands of the catalogue: listed without their modules, which are loaded when a command is called."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.registered = dict(self.commands)
        self.commands = {
            name: TyperCommand(name, help=entry.line, short_help=entry.line) for name, entry in COMMANDS.items()
        }

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Replace the line of the catalogue that was named by the command itself."""
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None:
            importlib.import_module(f"daemon.cli.{COMMANDS[name].module}")
            loaded = get_group(app)
            assert isinstance(loaded, CatalogueGroup)
            command = loaded.registered[name]
            for parameter in command.params:
                parameter.callback = _only_finite(parameter.callback)
        return name, command, rest

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The commands by who needs them, each line in full."""
        del ctx
        wide = max(map(len, COMMANDS))
        for title, entries in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(entry.name.ljust(wide), entry.line) for entry in entries])


def _only_finite(callback: Callable[..., Any] | None) -> Callable[..., Any]:
    """An option's callback that refuses what is no finite number: nan passes every range, and inf those without end."""

    def check(ctx: Any, parameter: Any, value: Any) -> Any:
        if isinstance(value, float) and not math.isfinite(value):
            raise typer.BadParameter(f"{value} is no number.", ctx=ctx, param=parameter)
        return value if callback is None else callback(ctx, parameter, value)

    return check


app = typer.Typer(
    name="iiwa-ident",
    cls=CatalogueGroup,
    help="Record a KUKA LBR iiwa over FRI and identify its dynamic parameters.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_GLOBAL_FLAGS = {"-v", "-vv", "-vvv", "--verbose", "-q", "--quiet"}


@app.callback(invoke_without_command=True)
def _common_options(
    verbose: Annotated[int, typer.Option("-v", "--verbose", count=True, help="More messages; -vv: tracebacks.")] = 0,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Errors only.")] = False,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if show_version:
        from importlib.metadata import version

        data(version("iiwa-ident"))
        raise typer.Exit
    set_verbosity(verbose, quiet)


def _flags_first(arguments: list[str]) -> list[str]:
    """Move -v and -q to the front, so that they may stand before or after the command's name."""
    end = arguments.index("--") if "--" in arguments else len(arguments)
    flags = [a for a in arguments[:end] if a in _GLOBAL_FLAGS]
    return flags + [a for i, a in enumerate(arguments) if i >= end or a not in _GLOBAL_FLAGS]


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with the contract's exit code; a traceback is printed only with -vv."""
    look_seldom()
    prepare_streams()
    words = _flags_first(sys.argv[1:] if arguments is None else arguments)
    try:
        with ends_as_interrupts():
            app(args=words, prog_name="iiwa-ident")
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except Exception as error:
        if words.count("-v") + 2 * words.count("-vv") + 3 * words.count("-vvv") >= 2:
            import traceback

            traceback.print_exc()
        text = sentence_of(error)
        if exit_code_of(error) == EXIT_INTERNAL:
            text = f"internal error ({type(error).__name__}): {text}; run again with -vv for the traceback"
        settle_stdout()
        complaint(f"iiwa-ident: {text}")
        sys.exit(exit_code_of(error))
