"""Claims about the commands that README and pages print: each exists, with the options it is printed with."""

from __future__ import annotations

import importlib
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command, get_group

from daemon.cli.app import CatalogueGroup, app
from daemon.cli.catalogue import COMMANDS
from fixtures.fake_robot.command_line import app as fake_robot

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
BLOCK = re.compile(r"^```[a-z]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
QUOTED = re.compile(r"`(iiwa-ident [^`\n]+)`")
FLAGS_OF_ALL = ("-v", "-vv", "-q")


def printed(page: Path) -> list[str]:
    """Every command of a page: lines of its blocks, and what stands between backquotes in a sentence."""
    text = page.read_text(encoding="utf-8")
    blocks = "\n".join(BLOCK.findall(text)).replace("\\\n", " ")
    lines = [line.strip().removeprefix("$ ").partition("  #")[0] for line in blocks.splitlines()]
    lines = [part.strip() for line in [*lines, *QUOTED.findall(BLOCK.sub("", text))] for part in line.split("&&")]
    return [line for line in lines if line.startswith("iiwa-ident ")]


PRINTED = [
    pytest.param(line, id=f"{page.stem}: {line.removeprefix('iiwa-ident ')}")
    for page in PAGES
    for line in dict.fromkeys(printed(page))
    if line.split()[1] not in ("--help", "--install-completion", "COMMAND")
]


def test_there_are_commands_to_judge() -> None:
    assert len(PRINTED) >= 70


def test_the_first_page_names_every_command() -> None:
    text = PAGES[0].read_text(encoding="utf-8")
    assert [name for name in COMMANDS if not re.search(rf"`(iiwa-ident )?{name}\b", text)] == []


@pytest.mark.parametrize("line", PRINTED)
def test_a_printed_command_has_the_options_it_is_printed_with(line: str) -> None:
    words = [word for word in shlex.split(line.replace("[", "").replace("]", "")) if word not in FLAGS_OF_ALL][1:]
    name, *words = words
    command = get_command(fake_robot) if name == "fake-robot" else command_called(name)
    context = command.context_class(command, info_name=name)
    # The parser refuses what the command does not know; the command itself is not run.
    command.make_parser(context).parse_args([word for word in words if word not in ("--", "…", "|")])


def command_called(name: str) -> Any:
    """A command of the catalogue, as its module registers it."""
    importlib.import_module(f"daemon.cli.{COMMANDS[name].module}")
    loaded = get_group(app)
    assert isinstance(loaded, CatalogueGroup)
    return loaded.registered[name]
