"""Claims about the size of files and functions: what is longer than a reader can hold says why.

Truth: the syntax tree of the sources. A signature with its options and a docstring are not counted: they are read as
tables and as text.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("fri_client", "daemon", "identification", "safety")
MOST_LINES_OF_A_FILE, MOST_LINES_OF_A_FUNCTION = 400, 60

REASONS = {
    "fri_client/session/session.py:judge": "1000 times a second, on plain locals: each further call costs turn-around",
    "daemon/cli/run.py:run": "gathers the options into one request, a line each, then starts it",
    "daemon/cli/design.py:design": "gathers the options into settings, a line each, then designs and shows",
}


def sources() -> list[Path]:
    return sorted(path for room in ROOMS for path in (ROOT / room).rglob("*.py"))


def long_functions(path: Path) -> Iterator[tuple[str, int]]:
    """Name in REASONS and lines of the body."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
            lines = (node.end_lineno or 0) - body[0].lineno + 1
            if lines > MOST_LINES_OF_A_FUNCTION:
                yield f"{path.relative_to(ROOT)}:{node.name}", lines


def test_no_file_is_longer_than_four_hundred_lines() -> None:
    lines = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in sources()}
    assert lines
    assert not {path: count for path, count in lines.items() if count > MOST_LINES_OF_A_FILE}


def test_a_function_of_more_than_sixty_lines_has_a_reason() -> None:
    long = {name for path in sources() for name, _ in long_functions(path)}
    assert long == set(REASONS)
