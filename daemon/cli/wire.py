"""Commands that touch datagrams only: `fri decode`, `fri encode`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from typing import Annotated, Literal

import typer

from daemon.cli.app import app
from daemon.cli.inputs import as_usage
from daemon.cli.output import data
from fri_client.messages import FriVersion
from fri_client.wire.json_form import decode_line, encode_line

fri_app = typer.Typer(
    help=(
        "FRI datagrams: bytes to fields and back.\n\n"
        "Example: iiwa-ident fri decode --fri-version 1.15 --direction command < commands.hex"
    ),
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(fri_app, name="fri")


VersionOption = Annotated[str, typer.Option("--fri-version", help="1.11, 1.14, 1.15, 1.16, 2.5 or 2.7.")]
DirectionOption = Annotated[
    Literal["monitoring", "command"], typer.Option("--direction", help="Robot to client, or client to robot.")
]


def _version(text: str) -> FriVersion:
    with as_usage(ValueError):
        return FriVersion.parse(text)


def _lines() -> Iterator[str]:
    return (line.strip() for line in sys.stdin)


@fri_app.command()
def decode(fri_version: VersionOption, direction: DirectionOption) -> None:
    """Hexadecimal datagrams on stdin, one a line, to one JSON object a line.

    Example: echo 0a080881800d10001801 | iiwa-ident fri decode --fri-version 1.15 --direction command
    """
    version = _version(fri_version)
    for line in _lines():
        if not data(json.dumps(decode_line(version, direction, line), allow_nan=False)):
            return


@fri_app.command()
def encode(fri_version: VersionOption, direction: DirectionOption) -> None:
    """JSON objects on stdin, as `decode` prints them, to hexadecimal datagrams, byte for byte as KUKA's library.

    Example: iiwa-ident fri encode --fri-version 2.7 --direction command < commands.jsonl
    """
    version = _version(fri_version)
    for line in _lines():
        if not data(encode_line(version, direction, line)):
            return
