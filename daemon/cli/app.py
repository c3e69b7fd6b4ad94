"""The application object of the command line and the one place where errors become exit codes.

0 done, 1 the answer is no, 2 usage, 65 bad data, 66 missing input, 69 unreachable, 70 internal, 74 I/O, 76 protocol,
78 configuration, 130 interrupted. Commands register themselves on `app` from the sibling modules.
"""

from __future__ import annotations

import importlib
import sys
import traceback
from importlib.metadata import version
from typing import Annotated

import typer

from daemon.cli.output import data, set_verbosity

EXIT_INTERNAL = 70
EXIT_INPUT_OUTPUT = 74
EXIT_MISSING_INPUT = 66
EXIT_INTERRUPTED = 130

app = typer.Typer(
    name="iiwa-ident",
    help="Record a KUKA LBR iiwa over FRI and identify its dynamic parameters.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_GLOBAL_FLAGS = {"-v", "-vv", "-vvv", "--verbose", "-q", "--quiet"}
_COMMAND_MODULES = (
    "acquisition",
    "analysis",
    "demonstration",
    "design",
    "diagnosis",
    "examination",
    "feasibility",
    "prove",
    "service",
    "simulation",
    "wire",
)


@app.callback(invoke_without_command=True)
def _common_options(
    verbose: Annotated[int, typer.Option("-v", "--verbose", count=True, help="More messages; -vv: tracebacks.")] = 0,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="Errors only.")] = False,
    show_version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if show_version:
        data(version("iiwa-ident"))
        raise typer.Exit
    set_verbosity(verbose, quiet)


def _flags_first(arguments: list[str]) -> list[str]:
    """Move -v and -q to the front, so that they may stand before or after the command's name."""
    if "fake-robot" in arguments:  # a program of its own with flags of its own
        return arguments
    end = arguments.index("--") if "--" in arguments else len(arguments)
    flags = [a for a in arguments[:end] if a in _GLOBAL_FLAGS]
    return flags + [a for i, a in enumerate(arguments) if i >= end or a not in _GLOBAL_FLAGS]


def exit_code_of(error: BaseException) -> int:
    """The contract's exit code of an error: its own `exit_code`, or the nearest one for errors of the system."""
    code = getattr(error, "exit_code", None)
    if isinstance(code, int):
        return code
    if isinstance(error, FileNotFoundError):
        return EXIT_MISSING_INPUT
    return EXIT_INPUT_OUTPUT if isinstance(error, OSError) else EXIT_INTERNAL


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and leave with the contract's exit code; a traceback is printed only with -vv."""
    words = _flags_first(sys.argv[1:] if arguments is None else arguments)
    for name in _COMMAND_MODULES:
        importlib.import_module(f"daemon.cli.{name}")
    try:
        app(args=words, prog_name="iiwa-ident")
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(EXIT_INPUT_OUTPUT)
    except Exception as error:
        if words.count("-v") + 2 * words.count("-vv") + 3 * words.count("-vvv") >= 2:
            traceback.print_exc()
        text = str(error) or type(error).__name__
        if exit_code_of(error) == EXIT_INTERNAL:
            text = f"internal error ({type(error).__name__}): {text}; run again with -vv for the traceback"
        print(f"iiwa-ident: {text}", file=sys.stderr)
        sys.exit(exit_code_of(error))
