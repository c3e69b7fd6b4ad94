"""The command `design`: an excitation trajectory, and what a run of it will tell before the robot moves."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from daemon.cli.app import app
from daemon.cli.inputs import GravityOption, MountOption, as_usage, installation_of
from daemon.cli.output import JsonOption, data, told_in_words
from daemon.cli.protection import not_a_recording


@app.command()
def design(
    purpose: Annotated[
        Literal["arm", "payload"],
        typer.Option("--for", help="arm: its own parameters; payload: a tool's load data, by a motion of the wrist."),
    ] = "arm",
    objective: Annotated[
        str | None,
        typer.Option("--objective", help="cond, d, a, detectability, payload or a mix: cond:1,d:2; default: by --for."),
    ] = None,
    harmonics: Annotated[int, typer.Option("--harmonics", min=3)] = 5,
    period: Annotated[float | None, typer.Option("--period", help="Seconds; default: 10, for a payload 20.")] = None,
    limits: Annotated[
        Literal["paper", "true"],
        typer.Option("--limits", help="paper: (14c-g); true: |q|, |dq|, |ddq|, and |τ| where a model predicts it."),
    ] = "paper",
    robot: Annotated[str, typer.Option("--robot", help="iiwa14, iiwa7 or a URDF with limits.")] = "iiwa14",
    seed: Annotated[int, typer.Option("--seed", min=0)] = 0,
    budget: Annotated[float | None, typer.Option("--budget", help="Seconds that the design may take.")] = 170.0,
    table: Annotated[bool, typer.Option("--table", help="Also write the 1 kHz table into the file.")] = False,
    periods: Annotated[int, typer.Option("--periods", min=1, help="Periods of the run that σ is predicted for.")] = 16,
    noise: Annotated[
        str | None,
        typer.Option("--noise", help="Torque noise of each joint, Nm per sample at 1 kHz: 0.17,0.17,… Weighs d and a."),
    ] = None,
    noise_colour: Annotated[
        str, typer.Option("--noise-colour", help="SHARE:HZ = share of the noise's variance that lies below a corner.")
    ] = "0.3:5",
    prior: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.json", help="Predicts the torque; default: masses of URDF, or Table 3."),
    ] = None,
    workspace: Annotated[
        Path | None,
        typer.Option("--workspace", metavar="FILE.yaml", help="Walls, boxes and tool that the motion keeps clear of."),
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="POSE", help="Where the arm stands before: 0,0.5,0,-1.2,0,0.8,0 (rad)."),
    ] = None,
    mount: MountOption = None,
    gravity: GravityOption = None,
    reference: Annotated[
        Literal["excitation", "sine_series", "polynomial_10", "polynomial_20"] | None,
        typer.Option("--reference", help="Instead, a motion to score models on; nothing is searched."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Trajectory to write; default: excitation.json.", callback=not_a_recording),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Design an excitation trajectory, the problem (13)/(14) of the paper, from many seeded starts.

    --for payload: the joints before the wrist hardly move; drive it once without the tool and once with it.
    Example: iiwa-ident design --objective cond --seed 1 --budget 120 --out excitation.json
    """
    from daemon.cli import design_parts as parts
    from identification.errors import DesignError
    from identification.excitation import limits_of_robot
    from identification.excitation.design import design_excitation
    from identification.excitation.local_search import DesignSettings
    from identification.excitation.nominal import nominal_parameters
    from identification.excitation.objective import DETECTABILITY, mixture_weights
    from identification.excitation.payload_term import wrist_limits
    from identification.excitation.prediction import NoiseColour, torque_noise
    from identification.excitation.reference import reference_trajectory
    from identification.robots import BUILT_IN_ROBOTS, load_robot
    from identification.robots.installation import ON_THE_FLOOR

    for_payload = purpose == "payload"
    objective = objective or ("payload" if for_payload else "cond")
    if period is None:
        period = 20.0 if for_payload else 10.0
    stand = installation_of(gravity, mount, None) or ON_THE_FLOOR
    model = load_robot(robot, stand)
    limits_used = limits_of_robot(model)
    # Only the built-in arms have a geometry to check self-collision and workspace on.
    has_shape = model.name in BUILT_IN_ROBOTS
    if not has_shape and (workspace is not None or start is not None):
        raise typer.BadParameter(f"--workspace and --from need the shape of the arm, and {robot} has none here.")
    acceptable, room = None, None
    if has_shape:
        acceptable, room = parts.surroundings(model, limits_used, stand, workspace, start, period)
    target = out or Path("excitation.json" if reference is None else f"{reference}.json")
    if reference is not None:
        score_on = reference_trajectory(reference, limits_used, seed, robot=model, acceptable=acceptable)
        if told_in_words(parts.write(score_on, target, table), json_file):
            data(f"Reference motion '{reference}' of {score_on.period_s:g} s for {score_on.robot} written to {target}")
        return
    colour = NoiseColour(*parts.read_numbers("--noise-colour", noise_colour.split(":"), 2))
    stated = None if noise is None else parts.read_numbers("--noise", noise.split(","), model.n)
    noise_nm = torque_noise(model, stated) if noise is not None or has_shape else None
    with as_usage(DesignError):
        for_effects = DETECTABILITY in mixture_weights(objective)
        weighing = noise_nm if noise is not None or for_effects else None
        settings = DesignSettings(
            objective=objective,
            harmonics=harmonics,
            period_s=period,
            limits=limits,
            seed=seed,
            budget_s=budget,
            noise_nm=None if weighing is None else tuple(weighing.tolist()),
            periods=periods,
        )
    nominal = nominal_parameters(model, prior)
    result = design_excitation(
        model,
        wrist_limits(limits_used, limits_used.middle) if for_payload else limits_used,
        settings,
        progress=parts.show_progress,
        clock=time.monotonic,
        acceptable=acceptable,
        nominal=nominal,
        room=room,
    )
    motion = result.trajectory
    document = parts.write(motion, target, table)
    promise = parts.promise_of(model, motion, noise_nm, periods, colour, for_payload, nominal if for_effects else None)
    if told_in_words({**document, **promise.to_json()}, json_file):
        data(f"cond(Y_b) = {result.cond:.2f}, log det(Y_b' Y_b) = {result.log_det:.1f}; written to {target}")
        if room is not None:
            parts.show_price_of_the_cell(model, motion, promise.predicted, colour)
        parts.show_verified(result.verified)
        parts.show_promise(promise, model.units, motion.period_s, periods)
