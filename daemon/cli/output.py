"""Where the command line prints: data on stdout, messages on stderr, results as JSON where asked for."""

from __future__ import annotations

import json
import logging
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.table import Table

JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON; '-' = stdout, in place of the text."),
]

_quiet = False


def set_verbosity(verbose: int, quiet: bool) -> None:
    """Set what reaches stderr: -q errors only, default progress, -v more, -vv tracebacks."""
    global _quiet
    _quiet = quiet
    level = logging.ERROR if quiet else (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(level=level, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s")


def message(text: str) -> None:
    """One line of progress on stderr, unless -q."""
    if not _quiet:
        print(text, file=sys.stderr, flush=True)


def data(text: str) -> None:
    """One piece of the result on stdout."""
    print(text, flush=True)


def show_table(table: Table) -> None:
    """A table on stdout, as wide as it needs to be: a piped table must not be cut to a terminal that is not there."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else max(100, int(os.environ.get("COLUMNS", "120")))
    Console(file=sys.stdout, width=width, highlight=False).print(table)


def write_json(destination: Path, result: Any) -> None:
    """Write `result` as JSON; '-' is stdout."""
    text = json.dumps(result, indent=1, allow_nan=False, ensure_ascii=False)
    if str(destination) == "-":
        data(text)
    else:
        destination.write_text(text + "\n", encoding="utf-8")


def wants_json_on_stdout(destination: Path | None) -> bool:
    """True when stdout must carry nothing but the JSON result."""
    return destination is not None and str(destination) == "-"
