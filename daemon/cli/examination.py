"""The command that examines host, network and link: `doctor`."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from daemon.cli.acquisition import parse_bind
from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, show_table, wants_json_on_stdout, write_json


@app.command()
def doctor(
    bind: Annotated[str, typer.Option("--bind", help="Address and port to listen on.")] = "127.0.0.1:30200",
    listen: Annotated[float, typer.Option("--listen", help="Seconds to listen for the robot.")] = 3.0,
    json_file: JsonOption = None,
) -> None:
    """Examine host, network, real-time limits and the link, and say what to do next. Moves nothing, answers nothing.

    Example: iiwa-ident doctor --bind 192.170.10.1:30200
    """
    from daemon.doctor import examine

    host, port = parse_bind(bind)
    report = examine(bind_host=host, bind_port=port, listen_s=listen)
    if json_file is not None:
        write_json(json_file, report.to_json())
    if not wants_json_on_stdout(json_file):
        table = Table("check", "result", "what was found")
        for item in report.checks:
            table.add_row(item.name, item.status, item.sentence)
        show_table(table)
        data(report.next_step)
    if not report.passed:
        raise typer.Exit(1)
