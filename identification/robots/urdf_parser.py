"""Pinocchio's URDF parser with its complaints in the error, in place of lines of C++ on the terminal."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from typing import BinaryIO

import pinocchio

DRAKE = "http://drake.mit.edu"
"""Name space of the elements that only Drake reads."""
STANDARD_ERROR = 2
MOST_COMPLAINTS = 2
"""The first say what is wrong and where; those after them that the whole cannot be read."""


def parsed_urdf(text: str) -> pinocchio.Model:
    """Pinocchio's model of a URDF text. Raises ValueError, whose text is what the parser found wrong."""
    with tempfile.TemporaryFile() as written:
        try:
            with _standard_error_to(written):
                return pinocchio.buildModelFromXML(text)
        except (ValueError, RuntimeError, IndexError) as error:
            raise ValueError(_complaints(written) or str(error).strip() or "no reason is given") from error


@contextlib.contextmanager
def _standard_error_to(file: BinaryIO) -> Iterator[None]:
    """What this process writes to file descriptor 2 goes to a file meanwhile; put back whatever happens."""
    try:
        kept = os.dup(STANDARD_ERROR)
    except OSError:  # a daemon may have closed it: there is nothing to keep quiet
        yield
        return
    try:
        if sys.stderr is not None:
            sys.stderr.flush()
        os.dup2(file.fileno(), STANDARD_ERROR)
        yield
    finally:
        os.dup2(kept, STANDARD_ERROR)
        os.close(kept)


def _complaints(written: BinaryIO) -> str:
    """The first complaints of urdfdom, each a line "Error:   what is wrong" with one on its source below."""
    written.seek(0)
    found = re.findall(r"^Error:\s+(.+?)\s*$", written.read().decode("utf-8", "replace"), re.MULTILINE)
    return "; ".join(found[:MOST_COMPLAINTS])
