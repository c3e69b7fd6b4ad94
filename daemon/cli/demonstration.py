"""The command `demo`: the whole chain against a fake robot, and the identified parameters beside the true ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from daemon.cli.acquisition import show_event, show_preflight
from daemon.cli.analysis import show_certificate
from daemon.cli.app import app
from daemon.cli.output import JsonOption, data, show_table, write_json
from daemon.cli.worker_view import wait_for_worker
from daemon.preparation import PreparedMotion, prepare_motion

PERIODS_UNUSED = 2


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for all files.")] = Path("demo-output"),
    periods: Annotated[int, typer.Option("--periods", min=1, help="Periods to record.")] = 16,
    realtime: Annotated[bool, typer.Option("--realtime", help="1 kHz by the clock instead of lockstep.")] = False,
    seed: Annotated[int, typer.Option("--seed", help="Of the fake robot's noise.")] = 1,
    json_file: JsonOption = None,
) -> None:
    """The whole chain without a robot: check, record over FRI, fit, compare with the truth and on other data.

    Example: iiwa-ident demo --out demo-output
    """
    from daemon import demonstration
    from identification.excitation import validation_trajectory
    from identification.model_file import read_model
    from identification.recordings import read_recording
    from identification.validation import validate_model

    motion = prepare_motion(None)
    data(f"1. Motion: {motion.name}, {motion.trajectory.period_s:g} s a period; preflight:")
    show_preflight(motion.preflight)
    if not motion.preflight.safe:
        raise typer.Exit(1)

    mode = "in real time at 1 kHz" if realtime else "in lockstep"
    data(f"2. Acquisition: {periods} periods {mode}, fake robot with seed {seed} in a process of its own")
    outcome = demonstration.record(
        motion, out / "excitation", periods=periods, seed=seed, realtime=realtime, fit=True, observe=show_event
    )
    for sentence in outcome.sentences:
        data(f"   {sentence}")
    if outcome.exit_code:
        raise typer.Exit(outcome.exit_code)
    if outcome.worker_status_file is not None:
        status = wait_for_worker(Path(outcome.worker_status_file))
        if status.phase != "done":
            raise typer.Exit(status.exit_code or 1)

    data(f"3. Another motion that the fit has not seen, {PERIODS_UNUSED} periods")
    other = prepare_motion_of(validation_trajectory(motion.robot), out)
    unused = demonstration.record(
        other, out / "unused", periods=PERIODS_UNUSED, seed=seed + 1, realtime=realtime, fit=False, observe=show_event
    )
    if unused.exit_code:
        raise typer.Exit(unused.exit_code)

    model_file = out / "excitation" / "model.json"
    document: dict[str, Any] = json.loads(model_file.read_text(encoding="utf-8"))
    data("4. Base parameters beside the fake robot's true ones, opened now")
    regressor = demonstration.demo_regressor()
    truth = demonstration.true_base_parameters(out / "excitation" / "fake_robot.json", regressor)
    show_comparison(document["base_parameters"], truth)

    data("5. RMS of measured minus modelled torque per joint, Nm, of the base and of the feasible parameters")
    model = read_model(model_file)
    tables = {}
    for what, folder, averaged in (("fitted", "excitation", periods), ("unused", "unused", PERIODS_UNUSED)):
        recording = read_recording(out / folder / "recording.mcap")
        table = validate_model(model, [recording])
        data(f"   {what} motion, mean of {averaged} period(s); the noise alone would give:")
        data(f"   {'':24s}" + "".join(f"{floor:8.3f}" for floor in table.rows[0].noise_floor_nm))
        data(table.text())
        tables[what] = table.to_json()
    show_certificate(document["certificate"])
    files = show_files(out)
    if json_file is not None:
        parameters = [{**p, "true": float(t)} for p, t in zip(document["base_parameters"], truth, strict=True)]
        write_json(json_file, {"base_parameters": parameters, "rms": tables, "files": files, "seed": seed})


def prepare_motion_of(trajectory: Any, out: Path) -> PreparedMotion:
    """Write a shipped trajectory into the demo's folder and prepare it as any user's file."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "unused-trajectory.json"
    file.write_text(json.dumps(trajectory.to_json(), indent=1) + "\n", encoding="utf-8")
    return prepare_motion(file)


def show_comparison(parameters: list[dict[str, Any]], truth: np.ndarray[Any, Any]) -> None:
    """Value, σ and truth of each base parameter, and how many of the well determined ones lie within 3 σ."""
    table = Table("parameter", "identified", "σ", "true", "difference in σ", "unit")
    within, determined = 0, 0
    for parameter, true in zip(parameters, truth, strict=True):
        value, std = parameter["value"], parameter["std"]
        distance = (value - true) / std
        if std < 0.05 * abs(value):
            determined += 1
            within += abs(distance) <= 3.0
        table.add_row(
            parameter["name"], f"{value:.5f}", f"{std:.5f}", f"{true:.5f}", f"{distance:+.1f}", parameter["unit"]
        )
    show_table(table)
    data(f"{within} of the {determined} parameters whose σ is below 5 % of their value are within 3 σ of the truth.")


def show_files(out: Path) -> list[str]:
    """Print where everything is, and return it."""
    files = sorted(path for path in out.rglob("*") if path.is_file() and not path.name.startswith("."))
    data("Files:")
    for file in files:
        data(f"  {file}  ({file.stat().st_size / 1e6:.2f} MB)")
    return [str(file) for file in files]
