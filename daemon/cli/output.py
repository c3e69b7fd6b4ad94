"""Where the command line prints: data on stdout, messages on stderr, results as JSON where asked for.

Here: a stream of any encoding, one whose reader has gone, one that is closed or full. A result that cannot be written
is an error (74); a message never costs a command its end. Not here: what lines, tables and bars look like at a
terminal (`terminal`, `progress`), which is loaded only where it is wanted.
"""

from __future__ import annotations

import codecs
import contextlib
import json
import logging
import os
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from daemon.cli.protection import in_its_folder, not_a_recording
from daemon.errors import LogIOError

JsonOption = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write the result as JSON; '-' = stdout, in place of the text.",
        callback=not_a_recording,
    ),
]

_SPELLING = {
    "σ": "sigma", "λ": "lambda", "τ": "tau", "φ": "phi", "²": "^2", "³": "^3", "µ": "u", "μ": "u", "°": " deg",
    "±": "+/-", "×": "x", "·": "*", "−": "-", "–": "-", "—": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "…": "...",
    "→": "->", "≤": "<=", "≥": ">=", "√": "sqrt ", "ß": "ss", "─": "-", "━": "-", "│": "|", "╸": "-", "╺": "-",
}  # fmt: skip

_quiet = False
_verbose = 0


def prepare_streams() -> None:
    """Let stdout and stderr be there, and spell what their encoding does not have: no sign may cost the result that it
    stands in.
    """
    _open_standard_streams()
    codecs.register_error("iiwa_ident_spelled", _spell_error)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)  # a test's stream may have none
        if reconfigure is not None:
            reconfigure(errors="iiwa_ident_spelled")


def _open_standard_streams() -> None:
    """Put something in the place of standard streams that the caller closed, before a file or a socket gets their
    number: nothing to read, nobody who hears messages, and a stdout that refuses every result.
    """
    for name, access in (("stdin", os.O_RDONLY), ("stdout", os.O_RDONLY), ("stderr", os.O_WRONLY)):
        if getattr(sys, name) is None:
            descriptor = os.open(os.devnull, access)  # the lowest number that is free: that of the stream
            os.set_inheritable(descriptor, descriptor <= 2)
            stream = os.fdopen(descriptor, "r" if name == "stdin" else "w", encoding="utf-8", closefd=False)
            setattr(sys, name, stream)


def _spell_error(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return _in_ascii(error.object[error.start : error.end]), error.end


def _in_ascii(text: str) -> str:
    """The text in ASCII: signs spelled, letters without their accents, '?' where nothing else is known."""
    spelled = "".join(_SPELLING.get(sign) or unicodedata.normalize("NFKD", sign) for sign in text)
    kept = "".join(sign for sign in spelled if not unicodedata.combining(sign))
    return kept.encode("ascii", "replace").decode("ascii")


def _spelled(text: str, stream: TextIO) -> str:
    """The text as the stream will show it, so that columns are as wide as what stands in them."""
    try:
        encoding = stream.encoding or "utf-8"
        return text.encode(encoding, "iiwa_ident_spelled").decode(encoding)
    except LookupError:  # streams were not prepared: a library caller's own
        return text


def set_verbosity(verbose: int, quiet: bool) -> None:
    """Set what reaches stderr: -q errors only, default progress, -v more, -vv tracebacks."""
    global _quiet, _verbose
    _quiet, _verbose = quiet, verbose
    level = logging.ERROR if quiet else (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(level=level, stream=sys.stderr, format="%(levelname)s %(name)s: %(message)s")


def is_quiet() -> bool:
    """Whether -q was given."""
    return _quiet


def is_verbose() -> bool:
    """Whether -v was given: tables behind a result are then shown as well."""
    return _verbose > 0


def message(text: str) -> None:
    """One line of progress on stderr, unless -q."""
    if not _quiet:
        _print(sys.stderr, text)


def complaint(text: str) -> None:
    """One error on stderr, also with -q."""
    _print(sys.stderr, text)


def data(text: str) -> bool:
    """One piece of the result on stdout; False when nobody reads it any more."""
    return _print(sys.stdout, text)


def data_lines(texts: Iterable[str]) -> None:
    """Results on stdout, each text on a line of its own."""
    for text in texts:
        data(text)


def _print(stream: TextIO, text: str) -> bool:
    if not stream.isatty():
        return _write(stream, text + "\n")
    from daemon.cli.terminal import drawn_lines

    return _write(stream, drawn_lines(text, stream))


def _write(stream: TextIO, text: str) -> bool:
    """Write and flush. A reader that has gone (`| head`) is no failure: the command still comes to its own end. Neither
    is a message that nobody can read. Raises LogIOError for a result that cannot be written.
    """
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        _to_nowhere(stream)  # what is still buffered would fail once more at the end of the process
        if stream is not sys.stdout or isinstance(error, BrokenPipeError):
            return False
        raise LogIOError("stdout", error) from error
    return True


def settle_stdout() -> None:
    """Let nothing wait in stdout that the end of the process would fail to write."""
    try:
        sys.stdout.flush()
    except OSError:
        _to_nowhere(sys.stdout)


def _to_nowhere(stream: TextIO) -> None:
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def show_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table on stdout: no wider than a terminal and no word cut; as wide as it needs to be, a row a line, elsewhere.

    Where a terminal is too narrow for the longest words side by side, each row becomes a block of lines.
    """
    heads, *rows = ([_spelled(cell, sys.stdout) for cell in row] for row in (heads, *rows))
    if not sys.stdout.isatty():
        from identification.text_table import aligned_lines

        _write(sys.stdout, "".join(f"{line}\n" for line in aligned_lines(heads, rows)))
        return
    from daemon.cli.terminal import drawn_table

    drawn = drawn_table(heads, rows, sys.stdout)
    if drawn is not None:
        _write(sys.stdout, drawn)
        return
    for row in rows:
        data(row[0])
        for head, cell in zip(heads[1:], row[1:], strict=True):
            data(f"  {head}: {cell}")


def write_json(destination: Path, result: Any) -> None:
    """Write `result` as JSON; '-' is stdout. Raises LogIOError, which names the file: a full disk names none."""
    text = json.dumps(result, indent=1, allow_nan=False, ensure_ascii=False)
    if str(destination) == "-":
        # Numbers and names have to come back as they were: JSON has its own escapes for what a stream cannot show.
        _write(sys.stdout, (text if _holds(sys.stdout, text) else json.dumps(result, indent=1, allow_nan=False)) + "\n")
    else:
        from identification.whole_file import write_whole

        try:
            write_whole(in_its_folder(destination), text + "\n")
        except OSError as error:
            raise LogIOError(str(destination), error) from error


def _holds(stream: TextIO, text: str) -> bool:
    try:
        text.encode(stream.encoding or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


def told_in_words(result: Any, json_file: Path | None) -> bool:
    """Write the result as JSON where that is asked for; whether words may follow: not where stdout carries the JSON."""
    if json_file is not None:
        write_json(json_file, result)
    return not wants_json_on_stdout(json_file)


def wants_json_on_stdout(destination: Path | None) -> bool:
    """True when stdout must carry nothing but the JSON result."""
    return destination is not None and str(destination) == "-"
