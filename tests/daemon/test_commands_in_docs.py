"""Claims about the commands that the pages print: every one is there, with the options that it is printed with."""

from __future__ import annotations

import importlib
import shlex
from pathlib import Path

import pytest
from typer.main import get_group

from daemon.cli.app import CatalogueGroup, app
from daemon.cli.catalogue import COMMANDS

PAGES = Path(__file__).resolve().parents[2] / "docs"
PRINTED = [
    line.removeprefix("iiwa-ident ").partition("  #")[0]
    for page in ("model-you-have.md",)
    for line in (PAGES / page).read_text(encoding="utf-8").splitlines()
    if line.startswith("iiwa-ident ")
]


def test_there_are_commands_to_judge() -> None:
    assert len(PRINTED) >= 9


@pytest.mark.parametrize("line", PRINTED)
def test_a_printed_command_has_the_options_it_is_printed_with(line: str) -> None:
    name, *words = shlex.split(line)
    importlib.import_module(f"daemon.cli.{COMMANDS[name].module}")
    loaded = get_group(app)
    assert isinstance(loaded, CatalogueGroup)
    command = loaded.registered[name]
    context = command.context_class(command, info_name=name)
    # The parser refuses what the command does not know; the command itself is not run.
    command.make_parser(context).parse_args([word for word in words if word != "--"])
