"""A file that is there as a whole or not at all: models, logs, pages and tables that a command writes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A file to write, beside `path`; it takes the place of `path` once all is written.

    A device or a pipe has no such place: it is written to as it is. A link stays, and the file that it names is
    replaced. Raises OSError, which names `path`.
    """
    target = Path(os.path.realpath(path))
    special = target.exists() and not target.is_file()
    partial = target if special else target.with_name(target.name + ".partial")
    try:
        yield partial
        if not special:
            os.replace(partial, target)
    except OSError as error:
        error.filename = str(path)  # a full disk names no file
        raise
    finally:
        if not special:
            partial.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a text so. Raises OSError, which names `path`."""
    with written_whole(path) as file:
        file.write_text(text, encoding="utf-8")
