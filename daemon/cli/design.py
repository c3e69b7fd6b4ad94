"""The command `design`: an excitation trajectory, and what a run of it will tell before the robot moves."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from daemon.cli.app import app
from daemon.cli.inputs import GravityOption, MountOption, as_usage, installation_of
from daemon.cli.output import JsonOption, data, message, show_table, told_in_words
from daemon.cli.protection import in_its_folder, not_a_recording

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from daemon.motion.clearance import Room
    from identification.excitation import FourierTrajectory, Trajectory
    from identification.excitation.design import DesignProgress
    from identification.excitation.effect_report import ShownEffect
    from identification.excitation.limits import ExcitationLimits
    from identification.excitation.payload_term import PayloadDeviations
    from identification.excitation.prediction import NoiseColour, PredictedDeviations
    from identification.physical_parameters import PhysicalParameters
    from identification.robots import RobotModel
    from identification.robots.installation import Installation

    FloatArray = npt.NDArray[np.float64]

SHOWN_LOAD_KG, SHOWN_CENTER_MM = 2.0, 2.0


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
    import numpy as np

    from identification.errors import DesignError
    from identification.excitation import limits_of_robot
    from identification.excitation.design import design_excitation
    from identification.excitation.local_search import DesignSettings
    from identification.excitation.nominal import nominal_parameters
    from identification.excitation.objective import DETECTABILITY, mixture_weights
    from identification.excitation.payload_term import wrist_limits
    from identification.excitation.prediction import NoiseColour
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
        acceptable, room = _surroundings(model, limits_used, stand, workspace, start, period)
    target = out or Path("excitation.json" if reference is None else f"{reference}.json")
    if reference is not None:
        score_on = reference_trajectory(reference, limits_used, seed, robot=model, acceptable=acceptable)
        if told_in_words(_write(score_on, target, table), json_file):
            data(f"Reference motion '{reference}' of {score_on.period_s:g} s for {score_on.robot} written to {target}")
        return
    colour = NoiseColour(*read_numbers("--noise-colour", noise_colour.split(":"), 2))
    noise_nm = _noise_nm(model, noise) if noise is not None or has_shape else None
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
        wrist_limits(limits_used, np.zeros(model.n)) if for_payload else limits_used,
        settings,
        progress=_show_progress,
        clock=time.monotonic,
        acceptable=acceptable,
        nominal=nominal,
        room=room,
    )
    motion = result.trajectory
    document = _write(motion, target, table)
    promise = _promise(model, motion, noise_nm, periods, colour, for_payload, nominal if for_effects else None)
    if told_in_words({**document, **promise.to_json()}, json_file):
        data(f"cond(Y_b) = {result.cond:.2f}, log det(Y_b' Y_b) = {result.log_det:.1f}; written to {target}")
        if room is not None:
            _show_price_of_the_cell(model, motion, promise.predicted, colour)
        show_verified(result.verified)
        _show_promise(promise, model.units, motion.period_s, periods)


def _noise_nm(model: RobotModel, stated: str | None) -> FloatArray:
    from identification.excitation.prediction import torque_noise

    return torque_noise(model, None if stated is None else read_numbers("--noise", stated.split(","), model.n))


def _surroundings(
    model: RobotModel,
    limits: ExcitationLimits,
    stand: Installation,
    workspace: Path | None,
    start: str | None,
    period_s: float,
) -> tuple[Callable[[Trajectory], bool], Room | None]:
    """Whether a built-in arm keeps clear of all around it, and the room to begin in where any was told."""
    import numpy as np

    from daemon.motion.clearance import room_of, safe_in
    from daemon.motion.workspace import load_surroundings

    around = load_surroundings(model.name, workspace)
    pose = None if start is None else np.array(read_numbers("--from", start.split(","), model.n))
    if pose is not None:
        _refuse_beyond(limits, pose)
    told = workspace is not None or start is not None
    return safe_in(around, model.name, pose, stand), room_of(around, pose, period_s) if told else None


def _refuse_beyond(limits: ExcitationLimits, pose: FloatArray) -> None:
    """Raises a usage error for a pose that no arm can stand in, nan included."""
    for joint, (low, value, high) in enumerate(zip(limits.position_lower, pose, limits.position_upper, strict=True), 1):
        if not low <= value <= high:
            raise typer.BadParameter(f"--from: joint {joint} at {value:g} rad is not in {low:.3f} to {high:.3f} rad.")


@dataclass(frozen=True, slots=True)
class _Promise:
    """What a run of a motion will tell. predicted: None where the noise is not known. weighed: by the motion's name."""

    predicted: PredictedDeviations | None
    effects: tuple[ShownEffect, ...]
    weighed: dict[str, PayloadDeviations]

    def to_json(self) -> dict[str, Any]:
        """For the trajectory's document on stdout."""
        found = self.predicted
        rows = [] if found is None else zip(found.names, found.std.tolist(), found.units, strict=True)
        return {
            "predicted_std": [{"name": name, "std": std, "unit": unit} for name, std, unit in rows],
            "effects": [_effect_json(item) for item in self.effects],
            "payload_std": {name: asdict(item) for name, item in self.weighed.items()},
        }


def _promise(
    model: RobotModel,
    motion: Trajectory,
    noise_nm: FloatArray | None,
    periods: int,
    colour: NoiseColour,
    for_payload: bool,
    nominal: PhysicalParameters | None,
) -> _Promise:
    """nominal: parameters that missing physics is looked for beside; None: it is not looked for."""
    from identification.base_parameters import BaseRegressor
    from identification.excitation.effect_report import effects_shown
    from identification.excitation.prediction import predict_deviations

    if for_payload:
        return _Promise(None, (), _weighed(model, motion, noise_nm, colour))
    if noise_nm is None:
        return _Promise(None, (), {})
    regressor = BaseRegressor(model)
    predicted = predict_deviations(regressor, motion, noise_nm=noise_nm, periods=periods, colour=colour)
    effects = () if nominal is None else effects_shown(regressor, motion, nominal, noise_nm, periods, colour)
    return _Promise(predicted, effects, {})


def _show_promise(promise: _Promise, units: Sequence[str], seconds: float, periods: int) -> None:
    if promise.weighed:
        _show_weighed(promise.weighed, seconds)
    else:
        _show_predicted(promise.predicted, units)
    if promise.effects:
        _show_effects(promise.effects, periods)


def _show_price_of_the_cell(
    model: RobotModel, motion: FourierTrajectory, predicted: PredictedDeviations | None, colour: NoiseColour
) -> None:
    """What a motion inside walls tells less than the shipped one in free space."""
    import numpy as np

    from identification.base_parameters import BaseRegressor
    from identification.excitation import default_trajectory
    from identification.excitation.objective import achieved_figures
    from identification.excitation.prediction import predict_deviations

    regressor, shipped = BaseRegressor(model), default_trajectory(model.name)
    free = achieved_figures(regressor, shipped)
    data(
        f"It keeps clear of everything, at {100 * motion.record['settings']['shrunk_to']:.0f} % of the amplitude it "
        f"was found with. The price: the shipped motion, in free space, has cond {free['cond']:.2f} and log det "
        f"{free['log_det']:.1f}."
    )
    if predicted is None:
        return
    alone = predict_deviations(
        regressor, shipped, noise_nm=predicted.noise_nm, periods=predicted.periods, colour=colour
    )
    grown = predicted.std / alone.std
    most = int(np.argmax(grown))
    data(
        f"σ of the base parameters is {np.median(grown):.2f} times as large (median), of {predicted.names[most]} "
        f"{grown[most]:.2f} times."
    )


def _weighed(
    model: RobotModel, motion: Trajectory, noise_nm: FloatArray | None, colour: NoiseColour
) -> dict[str, PayloadDeviations]:
    """To which σ a load is weighed with this motion, and with the shipped one in the same time."""
    from identification.excitation import default_trajectory
    from identification.excitation.payload_term import payload_deviations
    from identification.robots import BUILT_IN_ROBOTS

    motions = {"this motion": motion}
    if model.name in BUILT_IN_ROBOTS:
        motions["the shipped motion"] = default_trajectory(model.name)
    return {
        name: payload_deviations(model, each, motion.period_s, noise_nm=noise_nm, colour=colour)
        for name, each in motions.items()
    }


def show_verified(verified: dict[str, Any]) -> None:
    """How near each joint comes to its limits at 1 kHz, in percent, and whether all of them are kept."""
    titles = {"position": "position", "velocity": "velocity", "acceleration": "acceleration", "torque": "torque",
              "paper": "(14) of the paper"}  # fmt: skip
    joints = [f"joint {number}" for number in range(1, len(verified["paper"]) + 1)]
    show_table(
        (f"% of the limit, {verified['samples']} rows", *joints),
        [
            # A joint that moves has more than 0 % of any limit that there is.
            (title, *(f"{100.0 * value:.1f}" if value else "no limit" for value in verified[name]))
            for name, title in titles.items()
            if name in verified
        ],
    )
    true, paper = ("yes" if verified[f"within_{which}limits"] else "NO" for which in ("", "paper_"))
    data(f"Inside the limits of the arm: {true}; inside (14) of the paper, at rest at the start: {paper}.")


def _show_weighed(weighed: dict[str, PayloadDeviations], seconds: float) -> None:
    data(f"σ of a load of {SHOWN_LOAD_KG:g} kg, from a run of {seconds:g} s without it and one with it:")
    for name, item in weighed.items():
        x, y, z = item.center_mm(SHOWN_LOAD_KG)
        data(f"  {name}: mass {1e3 * item.mass_kg:.2g} g, centre ({x:.2g}, {y:.2g}, {z:.2g}) mm")
        lightest = 1.96 * max(item.center_mm(1.0)) / SHOWN_CENTER_MM
        data(
            f"    ± {SHOWN_CENTER_MM:g} mm (95 %) of every load from {lightest:.2g} kg on; "
            "driven four times as long, of half of that."
        )


def read_numbers(option: str, parts: list[str], count: int) -> list[float]:
    """So many numbers of an option's text; whether they fit is judged where they are used."""
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise typer.BadParameter(f"{option} takes {count} numbers, not '{' '.join(parts)}'.")
    return numbers


def _write(trajectory: Trajectory, target: Path, table: bool) -> dict[str, Any]:
    document = trajectory.to_json(table_rate_hz=1000.0 if table else None)
    in_its_folder(target).write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return document


def _show_progress(step: DesignProgress) -> None:
    where = f"search {step.done}/{step.planned}" if step.planned else f"hop {step.done}"
    message(f"stage {step.stage}/{step.stages}, {where}: best {step.best:.2f}")


def _show_predicted(predicted: PredictedDeviations | None, units: Sequence[str]) -> None:
    from identification.robots.joint_units import in_units

    if predicted is None:
        data("No σ is predicted: state the torque noise of each joint with --noise.")
        return
    noise = ", ".join(f"{x:g}" for x in predicted.noise_nm)
    data(in_units(f"σ that {predicted.periods} periods will give, torque noise {noise} Nm", units) + ":")
    for name, std, unit in zip(predicted.names, predicted.std, predicted.units, strict=True):
        data(f"  {name:<8} {std:.2g} {unit}")


def _show_effects(effects: tuple[ShownEffect, ...], periods: int) -> None:
    """The ones that show least, and how many show."""
    from identification.excitation.effect_report import NAME_STRENGTH, TOOL_STRENGTH

    seen = sum(item.strength >= TOOL_STRENGTH for item in effects)
    data(
        f"Missing physics in {periods} periods: {seen} of {len(effects)} effects of plausible size reach the λ of "
        f"{TOOL_STRENGTH:.0f} at which a diagnosis finds them; a name needs {NAME_STRENGTH:.0f}. "
        "The twelve that show least:"
    )
    show_table(
        ("effect", "joint", "plausible size", "λ", "smallest, λ = 24", "smallest, found", "looks like"),
        [
            (
                item.effect,
                str(item.joint) + (f" from {item.other_joint}" if item.other_joint else ""),
                f"{item.size:g} {item.unit}",
                f"{item.strength:.3g}",
                f"{item.smallest_oracle:.2g}",
                f"{item.smallest_tool:.2g}",
                f"{item.alike} ({item.cosine:.2f})" if item.alike else "",
            )
            for item in sorted(effects, key=lambda item: item.strength)[:12]
        ],
    )


def _effect_json(effect: ShownEffect) -> dict[str, Any]:
    return {key: None if value == float("inf") else value for key, value in asdict(effect).items()}
