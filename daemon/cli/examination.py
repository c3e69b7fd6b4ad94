"""The command that examines host, network and link: `doctor`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli.acquisition import parse_bind
from daemon.cli.app import app
from daemon.cli.inputs import ArmOption, RecordedArm, RobotOption, as_usage, settings_of
from daemon.cli.output import JsonOption, data, show_table, told_in_words

if TYPE_CHECKING:
    from daemon.doctor.host_checks import DoctorCheck
    from identification.mismatch.set_up import SetUpCheck


@app.command()
def doctor(
    bind: Annotated[
        str | None, typer.Option("--bind", help="Address and port to listen on; default 127.0.0.1:30200.")
    ] = None,
    listen: Annotated[float, typer.Option("--listen", min=0.1, max=600.0, help="Seconds to listen.")] = 3.0,
    answer: Annotated[
        bool, typer.Option("--answer", help="Answer monitoring states, so that the robot grades the link. No commands.")
    ] = False,
    fri_version: Annotated[
        str | None, typer.Option("--fri-version", help="With --answer, where the bytes do not tell the version.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder that runs will go to; default: this one.")] = None,
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="Take address, version and folder from this file.")
    ] = None,
    arm: ArmOption = None,
    logs: Annotated[
        list[Path] | None,
        typer.Option("--log", metavar="LOG", help="Instead: how this recording was made; may be given repeatedly."),
    ] = None,
    robot: RobotOption = None,
    json_file: JsonOption = None,
) -> None:
    """Examine host, network, firewall, real-time limits, disk and link, and say what to do next. Moves nothing.

    Grades the link: A nothing lost and regular, B good, C usable for a try, D not usable. Exit code 1 when a check
    failed; warnings are allowed. --log: gravity, signs, clock, units, order of joints, rows, constancy, one body, late
    torque and load data of a recording, without any model of the arm.

    Example: iiwa-ident doctor --bind 192.170.10.1:30200 --answer
    """
    if logs:
        _examine_logs(logs, robot, json_file)
        return
    from daemon.api import AUTO_VERSION
    from daemon.config import parse_version
    from daemon.doctor.doctor import examine
    from daemon.doctor.link_observation import Mirror
    from fri_client.messages import FriVersion

    settings = settings_of(config, arm)
    host, port = (settings.fri.bind_host, settings.fri.bind_port) if bind is None else parse_bind(bind)
    named = fri_version or (None if config is None else settings.fri.version)
    with as_usage(ValueError):
        version = None if named is None or parse_version(named) == AUTO_VERSION else FriVersion.parse(named)
    report = examine(
        bind_host=host,
        bind_port=port,
        listen_s=listen,
        folder=out or (None if config is None else Path(settings.output)),
        mirror=Mirror(version) if answer else None,
    )
    if told_in_words(report.to_json(), json_file):
        _show(report.checks)
        data(report.next_step)
    if not report.passed:
        raise typer.Exit(1)


def _examine_logs(logs: Sequence[Path], robot: str | None, json_file: Path | None) -> None:
    from identification.mismatch.set_up import examine_set_up

    # What is found is the result here, and not said beside it.
    inputs = RecordedArm(robot).load(logs, say=False)
    checks = examine_set_up(inputs.recordings, inputs.robot)
    passed = all(item.status != "failed" for item in checks)
    result = {"format": "iiwa-ident/set-up/1", "recordings": list(map(str, logs)), "passed": passed,
              "checks": [asdict(item) for item in checks]}  # fmt: skip
    if told_in_words(result, json_file):
        _show(checks)
    if not passed:
        raise typer.Exit(1)


def _show(checks: Sequence[DoctorCheck] | Sequence[SetUpCheck]) -> None:
    show_table(
        ("check", "result", "what was found"),
        [(item.name, item.status if item.status != "failed" else "FAILED", item.sentence) for item in checks],
    )
