"""The command `feasibility`: can any robot have a model's base parameters, and how far away is the nearest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from daemon.cli.app import app
from daemon.cli.inputs import ModelArgument, RecordedArm, RobotOption
from daemon.cli.output import JsonOption, data, told_in_words


@app.command()
def feasibility(
    model_file: ModelArgument,
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Motion to judge on; default: the shipped excitation of an iiwa.")
    ] = None,
    robot: RobotOption = None,
    json_file: JsonOption = None,
) -> None:
    """Can any robot made of matter have these base parameters, and how many Nm away is the nearest? Exit 1 if none can.

    Example: iiwa-ident feasibility model.json
    """
    import numpy as np

    from identification.base_parameters import BaseRegressor
    from identification.estimators.nearest import nearest_physical
    from identification.excitation import default_trajectory
    from identification.fitting.processing import process
    from identification.fitting.settings import FitSettings
    from identification.model_file import read_model
    from identification.recording_fit import MOST_STATES, states_of
    from identification.robots import BUILT_IN_ROBOTS, load_robot
    from identification.robots.joint_units import in_units

    model = read_model(model_file)
    arm = load_robot(robot) if robot is not None else model.load_robot()
    if logs:
        stretches = [
            stretch
            for log in RecordedArm(robot).load(logs, model_robot=arm).recordings
            for stretch in process(log, arm, FitSettings()).stretches
        ]
        states = states_of(stretches)
    elif arm.name in BUILT_IN_ROBOTS:
        trajectory = default_trajectory(arm.name)
        states = trajectory.evaluate(np.linspace(0.0, trajectory.period_s, MOST_STATES, endpoint=False))
    else:
        raise typer.BadParameter(f"{arm.name} has no shipped motion; name a recording of it after the model.")
    base = BaseRegressor(arm, model.options)
    spread = dict(zip(model.names, model.std.tolist(), strict=True))
    values = model.base_values(base)
    answer = nearest_physical(values, base, states, std=np.array([spread[name] for name in base.names]))
    if told_in_words(answer.to_json(), json_file):
        data(in_units(answer.sentence(), arm.units))
        data(f"RMS per joint, {arm.torque_unit}: " + " ".join(f"{value:.3f}" for value in answer.distance_nm))
        pooled = (
            f"Over all joints {answer.pooled_nm:.4f} Nm; by the dual program no robot comes nearer than "
            f"{answer.lower_bound_nm:.4f} Nm."
        )
        data(in_units(pooled, arm.units))
    raise typer.Exit(0 if answer.feasible else 1)
