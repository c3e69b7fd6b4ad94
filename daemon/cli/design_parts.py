"""What the command `design` needs beside its options: the cell, what a motion promises, and how that is shown.

Loaded when a motion is designed, and not for the command's help.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

from daemon.cli.output import data, message, show_table, write_json
from daemon.motion.clearance import Room, room_of, safe_in
from daemon.motion.workspace import Surroundings, load_surroundings
from daemon.words import counted
from identification.arrays import FloatArray
from identification.base_parameters import BaseRegressor
from identification.errors import DesignError
from identification.excitation import FourierTrajectory, Trajectory, default_trajectory
from identification.excitation.design import DesignProgress
from identification.excitation.effect_report import TOOL_STRENGTH, ShownEffect, effects_shown
from identification.excitation.limits import ExcitationLimits
from identification.excitation.objective import achieved_figures
from identification.excitation.payload_term import PayloadDeviations, payload_deviations
from identification.excitation.prediction import NoiseColour, PredictedDeviations, predict_deviations
from identification.mismatch.settings import LEAST_SHOWN
from identification.physical_parameters import PhysicalParameters
from identification.robots import BUILT_IN_ROBOTS, RobotModel
from identification.robots.installation import Installation
from identification.robots.joint_units import in_units
from safety.limits import limits_for
from safety.preflight_distance import SampledPath, nearest_sentence

SHOWN_LOAD_KG, SHOWN_CENTER_MM = 2.0, 2.0


def surroundings(
    model: RobotModel,
    limits: ExcitationLimits,
    stand: Installation,
    workspace: Path | None,
    start: str | None,
    period_s: float,
) -> tuple[Callable[[Trajectory], bool], Room | None]:
    """Whether a built-in arm keeps clear of all around it, and the room to begin in where any was told."""
    around = load_surroundings(model.name, workspace)
    pose = None if start is None else np.array(read_numbers("--from", start.split(","), model.n))
    if pose is not None:
        _refuse_beyond(limits, pose)
        _refuse_contact(around, model.name, pose)
    told = workspace is not None or start is not None
    return safe_in(around, model.name, pose, stand), room_of(around, pose, period_s) if told else None


def _refuse_beyond(limits: ExcitationLimits, pose: FloatArray) -> None:
    """Raises a usage error for a pose that no arm can stand in, nan included."""
    for joint, (low, value, high) in enumerate(zip(limits.position_lower, pose, limits.position_upper, strict=True), 1):
        if not low <= value <= high:
            raise typer.BadParameter(f"--from: joint {joint} at {value:g} rad is not in {low:.3f} to {high:.3f} rad.")


def _refuse_contact(around: Surroundings, robot: str, pose: FloatArray) -> None:
    """Raises DesignError for a pose that is nearer to anything than the margins: no motion that is found could help."""
    _, distances = around.distances(limits_for(robot)).check([SampledPath(pose[None], 0.0)], "start ramp")
    if near := [item for item in distances if not item.kept]:
        closest = min(near, key=lambda item: item.guaranteed_m - item.margin_m)
        raise DesignError(f"No motion can begin at the pose of --from: {nearest_sentence(closest)}")


@dataclass(frozen=True, slots=True)
class Promise:
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
            "effects": [
                {key: None if value == float("inf") else value for key, value in asdict(item).items()}
                for item in self.effects
            ],
            "payload_std": {name: asdict(item) for name, item in self.weighed.items()},
        }


def promise_of(
    model: RobotModel,
    motion: Trajectory,
    noise_nm: FloatArray | None,
    periods: int,
    colour: NoiseColour,
    for_payload: bool,
    nominal: PhysicalParameters | None,
) -> Promise:
    """nominal: parameters that missing physics is looked for beside; None: it is not looked for."""
    if for_payload:
        return Promise(None, (), _weighed(model, motion, noise_nm, colour))
    if noise_nm is None:
        return Promise(None, (), {})
    regressor = BaseRegressor(model)
    predicted = predict_deviations(regressor, motion, noise_nm=noise_nm, periods=periods, colour=colour)
    effects = () if nominal is None else effects_shown(regressor, motion, nominal, noise_nm, periods, colour)
    return Promise(predicted, effects, {})


def show_promise(promise: Promise, units: Sequence[str], seconds: float, periods: int) -> None:
    """What a run will tell, on stdout."""
    if promise.weighed:
        _show_weighed(promise.weighed, seconds)
    else:
        _show_predicted(promise.predicted, units)
    if promise.effects:
        show_effects(promise.effects, periods)


def show_price_of_the_cell(
    model: RobotModel, motion: FourierTrajectory, predicted: PredictedDeviations | None, colour: NoiseColour
) -> None:
    """What a motion inside walls tells less than the shipped one in free space."""
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


def write(trajectory: Trajectory, target: Path, table: bool) -> dict[str, Any]:
    """Write a motion; its document. table: with its rows at 1 kHz. Raises LogIOError, which names the file."""
    document = trajectory.to_json(table_rate_hz=1000.0 if table else None)
    write_json(target, document)
    return document


def show_progress(step: DesignProgress) -> None:
    """A line for a step of the search."""
    where = f"search {step.done}/{step.planned}" if step.planned else f"hop {step.done}"
    message(f"stage {step.stage}/{step.stages}, {where}: best {step.best:.2f}")


def _show_predicted(predicted: PredictedDeviations | None, units: Sequence[str]) -> None:
    if predicted is None:
        data("No σ is predicted: state the torque noise of each joint with --noise.")
        return
    noise = ", ".join(f"{x:g}" for x in predicted.noise_nm)
    data(in_units(f"σ that {counted(predicted.periods, 'period')} will give, torque noise {noise} Nm", units) + ":")
    for name, std, unit in zip(predicted.names, predicted.std, predicted.units, strict=True):
        data(f"  {name:<8} {std:.2g} {unit}")


def show_effects(effects: tuple[ShownEffect, ...], periods: int) -> None:
    """The ones that show least, and how many show."""
    seen = sum(item.strength >= TOOL_STRENGTH for item in effects)
    data(
        f"Missing physics in {counted(periods, 'period')}: {seen} of {len(effects)} effects of plausible size reach "
        f"the λ of {TOOL_STRENGTH:.0f} at which a diagnosis finds them; a name needs {LEAST_SHOWN:.0f}. "
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
