"""Pinocchio's URDF parser with its complaints in the error, in place of lines of C++ on the terminal.

Also what it passes over in silence: macros that nobody expanded, and bodies that it could not read.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import pinocchio

from identification.errors import RobotError

DRAKE = "http://drake.mit.edu"
"""Name space of the elements that only Drake reads."""
STANDARD_ERROR = 2
MOST_COMPLAINTS = 2
"""The first say what is wrong and where; those after them that the whole cannot be read."""
_NO_BODY = "Could not parse inertial element"


def parsed_urdf(text: str, *, bodies: bool = False) -> pinocchio.Model:
    """Pinocchio's model of a URDF text. Raises ValueError, whose text is what the parser found wrong.

    bodies: whether its masses and inertias count. The parser goes on without those it cannot read.
    """
    with tempfile.TemporaryFile() as written:
        try:
            with _standard_error_to(written):
                model = pinocchio.buildModelFromXML(text)
        except (ValueError, RuntimeError, IndexError) as error:
            found = "; ".join(_complaints(written)[:MOST_COMPLAINTS])
            raise ValueError(found or str(error).strip() or "no reason is given") from error
        complaints = _complaints(written)
    for place, complaint in enumerate(complaints):
        if bodies and _NO_BODY in complaint:  # the one before says why
            raise ValueError("; ".join(complaints[max(place - 1, 0) : place + 1]))
    return model


def text_of(path: Path) -> str:
    """The text of a file, in the encoding that it declares as XML, else in UTF-8."""
    with path.open("rb") as file:
        declared = re.match(rb"""<\?xml[^>]*encoding=["']([A-Za-z0-9._-]+)["']""", file.read(200))
    return path.read_text("utf-8" if declared is None else declared.group(1).decode("ascii"))


def refuse_xacro(root: ElementTree.Element, source: str | Path) -> None:
    """Raises RobotError for a description with xacro elements: readers pass over them and all that they stand for."""
    for element in root.iter():
        space, _, name = str(element.tag).rpartition("}")
        if space.endswith("xacro"):
            raise RobotError.at(
                source,
                f"it holds xacro that is not expanded (<xacro:{name}>); write the URDF first: "
                f"xacro {Path(source).name} > expanded.urdf.",
            )


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


def _complaints(written: BinaryIO) -> list[str]:
    """The complaints of urdfdom, each a line "Error:   what is wrong" with one on its source below."""
    written.seek(0)
    return re.findall(r"^Error:\s+(.+?)\s*$", written.read().decode("utf-8", "replace"), re.MULTILINE)
