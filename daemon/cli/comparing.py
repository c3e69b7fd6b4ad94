"""The command `compare`: what changed between recordings or models of one arm, and which model fits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from daemon.cli.app import app
from daemon.cli.inputs import (
    GravityOption,
    JointsOption,
    LockOption,
    MountOption,
    RobotOption,
    installation_of,
    load_inputs,
)
from daemon.cli.output import JsonOption, data, show_table, wants_json_on_stdout, write_json

if TYPE_CHECKING:
    from identification.audit.between import Change

SHOWN = 8


@app.command()
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="The recording or model.json to compare with.")],
    others: Annotated[list[Path], typer.Argument(metavar="B…", help="Recordings to compare, each with A.")],
    robot: RobotOption = None,
    joints: JointsOption = None,
    lock: LockOption = None,
    mount: MountOption = None,
    gravity: GravityOption = None,
    json_file: JsonOption = None,
) -> None:
    """What changed between two dates, arms or tools: the fewest causes, then parameter by parameter in σ.

    Exit code 0 whatever the answer. Example: iiwa-ident compare runs/may/recording.mcap runs/june/recording.mcap
    """
    from identification.audit.between import changes_between, model_of
    from identification.model_file import read_model

    known = read_model(first) if first.suffix == ".json" else None
    inputs = load_inputs(
        others if known is not None else [first, *others],
        robot,
        joints=joints,
        installation=installation_of(gravity, mount, lock),
        model_robot=None if known is None else known.load_robot(),
    )
    model = known if known is not None else model_of(inputs.recordings[0], inputs.robot)
    recordings = inputs.recordings if known is not None else inputs.recordings[1:]
    changes = [changes_between(model, recording, inputs.robot) for recording in recordings]
    if json_file is not None:
        write_json(json_file, {"format": "iiwa-ident/comparison/1", "with": str(first), "changes": [
            {"recording": str(file), **change.to_json()} for file, change in zip(others, changes, strict=True)
        ]})  # fmt: skip
    if not wants_json_on_stdout(json_file):
        for file, change in zip(others, changes, strict=True):
            show_change(f"{first} → {file}", change)


def show_change(title: str, change: Change) -> None:
    """The causes in sentences, then the parameters that differ most."""
    data(title)
    for sentence in [item.sentence for item in change.audit.differences] or [change.audit.sentence]:
        data(f"  {sentence}")
    table: Any = Table("parameter", "before", "after", "unit", "difference in σ")
    for item in change.parameters[:SHOWN]:
        table.add_row(item.name, f"{item.before:.4g}", f"{item.after:.4g}", item.unit, f"{item.sigmas:+.1f}")
    show_table(table)
