"""The command `demo`: the whole chain against a fake robot that hides an effect, and the verdict beside the truth."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.cli.acquisition import show_preflight
from daemon.cli.analysis import show_certificate
from daemon.cli.app import app
from daemon.cli.diagnosis import VERDICTS
from daemon.cli.output import JsonOption, data, data_lines, is_verbose, show_table, wants_json_on_stdout, write_json
from daemon.cli.protection import folder_to_write
from daemon.cli.rms_view import show_rms
from daemon.cli.run_view import run_shown
from daemon.folders import make_folder
from daemon.words import counted

if TYPE_CHECKING:
    import numpy as np

    from daemon.api import RunOutcome
    from daemon.motion.preparation import PreparedMotion
    from identification.fitting.rms import RmsTable

PERIODS_UNUSED = 4


def fresh_folder(folder: Path) -> Path:
    """The folder itself if nothing is in it, else the first of folder-2, folder-3, … that is free: nothing is lost."""
    number, free = 1, folder
    while free.exists() and (not free.is_dir() or any(free.iterdir())):
        number += 1
        free = folder.with_name(f"{folder.name}-{number}")
    return free


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", help="Folder for all files.", callback=folder_to_write)] = Path(
        "demo-output"
    ),
    periods: Annotated[int, typer.Option("--periods", min=1, help="Periods to record.")] = 16,
    realtime: Annotated[bool, typer.Option("--realtime", help="1 kHz by the clock instead of lockstep.")] = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the fake robot's noise and of what it hides.")] = 1,
    json_file: JsonOption = None,
) -> None:
    """The whole chain without a robot: record over FRI, fit, find what the robot hides, open its seal, compare.

    Example: iiwa-ident demo --seed 7 --out demo-output
    """
    # The story is no part of a result that another program reads from stdout.
    with redirect_stdout(sys.stderr) if wants_json_on_stdout(json_file) else nullcontext():
        result = demonstrate(fresh_folder(out), periods, realtime=realtime, seed=seed)
    if json_file is not None:
        write_json(json_file, result)


def demonstrate(out: Path, periods: int, *, realtime: bool, seed: int) -> dict[str, Any]:
    """The demo's steps, told on stdout as they happen, and what came of them as plain JSON types."""
    from daemon.cli.worker_view import wait_for_worker
    from daemon.motion.preparation import prepare_motion
    from daemon.run import demonstration
    from identification.excitation import validation_trajectory

    motion = prepare_motion(None)
    safe = "safe to run" if motion.preflight.safe else "NOT safe"
    data(f"1. Motion: {motion.name}, {motion.trajectory.period_s:g} s a period: {safe}")
    if is_verbose() or not motion.preflight.safe:
        show_preflight(motion)
    if not motion.preflight.safe:
        raise typer.Exit(1)

    mode = "in real time at 1 kHz" if realtime else "in lockstep"
    commitments: list[str] = []

    def publish(commitment: str) -> None:
        commitments.append(commitment)
        hides = f"The fake robot hides one effect, drawn from seed {seed}" if len(commitments) == 1 else "Salted anew"
        data(f"   {hides}. SHA-256 of the sealed label:")
        data(f"   {commitment}")

    def acquire(chosen: PreparedMotion, name: str, count: int, heldout: tuple[str, ...], fit: bool) -> RunOutcome:
        with run_shown() as view:
            outcome = demonstration.record(
                chosen, out / name, periods=count, seed=seed if fit else seed + 1, realtime=realtime, fit=fit,
                observe=view.observe, hidden_effect=seed, publish=publish, heldout=heldout,
            )  # fmt: skip
        view.show_outcome(outcome.sentences, indent="   ")
        if outcome.exit_code:
            raise typer.Exit(outcome.exit_code)
        return outcome

    data(f"2. Another motion first, {PERIODS_UNUSED} periods {mode}: what the fit will not see, to check names on")
    unused = acquire(
        prepare_motion_of(validation_trajectory(motion.robot), out), "unused", PERIODS_UNUSED, (), fit=False
    )
    data(f"3. Acquisition: {counted(periods, 'period')} {mode}; the worker fits and diagnoses from the logs alone")
    outcome = acquire(motion, "excitation", periods, unused.recordings, fit=True)
    assert outcome.worker_pid is not None
    status = wait_for_worker(Path(outcome.out_dir), outcome.worker_pid)
    if status.phase != "done" or status.diagnosis_error is not None:
        raise typer.Exit(status.exit_code or 1)

    return _outcome_told(out, commitments[-1], seed)


def _outcome_told(out: Path, commitment: str, seed: int) -> dict[str, Any]:
    """What was found beside what was hidden, on stdout and as plain JSON types."""
    from daemon.run import demonstration
    from identification.base_parameters import BaseRegressor
    from identification.robots import load_robot

    folder = out / "excitation"
    document, extended, diagnosis = (
        json.loads((folder / name).read_text(encoding="utf-8"))
        for name in ("model.json", "diagnosis/model.json", "diagnosis/diagnosis.json")
    )
    label = demonstration.opened_effect(folder / "fake_robot.json", commitment)
    truth = demonstration.true_base_parameters(folder / "fake_robot.json", BaseRegressor(load_robot("iiwa14")))
    tables = rms_tables(out, {"fitted motion": "excitation", "unused motion": "unused"})
    files = sorted(str(path) for path in out.rglob("*") if path.is_file() and not path.name.startswith("."))
    if is_verbose():
        _show_tables(document, extended, truth, tables, files)
    data("")
    data("What was found in the recordings:")
    show_verdict(diagnosis)
    data("What was hidden (the seal is opened; its hash is the one published before the motion):")
    data(f"   {in_words(label)}")
    data(f"   {judgement(diagnosis, label)}")
    data(f"   {parameters_in_words(extended['base_parameters'], truth)}")
    data("The page to open:")
    data(f"   {folder / 'diagnosis' / 'report.html'}")
    return {
        "base_parameters": [{**p, "true": float(t)} for p, t in zip(extended["base_parameters"], truth, strict=True)],
        "rms": {name: table.to_json() for name, table in tables.items()},
        "verdict": diagnosis["verdict"],
        "findings": diagnosis["findings"],
        "hidden": label,
        "commitment": commitment,
        "right": is_right(diagnosis, label),
        "files": files,
        "seed": seed,
    }


def _show_tables(
    document: dict[str, Any],
    extended: dict[str, Any],
    truth: np.ndarray[Any, Any],
    tables: dict[str, RmsTable],
    files: list[str],
) -> None:
    data("4. Base parameters beside the fake robot's true ones: fitted together with the effects, and without them")
    show_comparison(extended["base_parameters"], document["base_parameters"], truth)
    data("5. How well the models fit, base and feasible parameters")
    for what, table in tables.items():
        show_rms(table, f"{what[:1].upper()}{what[1:]}: RMS of measured minus modelled torque", percent=False)
    show_certificate(document["certificate"])
    data("6. Files")
    data_lines(f"   {file}" for file in files)


def show_verdict(diagnosis: dict[str, Any]) -> None:
    """Verdict, findings and what remains, as `diagnose` says them, and the joint that gains most on unused data."""
    data(f"   {VERDICTS[diagnosis['verdict']]}")
    data_lines(f"   - {finding['sentence']}" for finding in diagnosis["findings"])
    data(f"   {diagnosis['remaining']}")
    heldout = diagnosis["heldout"]
    if heldout is not None and diagnosis["findings"]:
        before, after, noise = (heldout[key] for key in ("rms_before_nm", "rms_after_nm", "noise_floor_nm"))
        joint = max(range(len(before)), key=lambda place: abs(before[place] - after[place]))
        verb = "falls" if after[joint] <= before[joint] else "RISES"
        data(
            f"   On the motion that was not fitted, the RMS of joint {joint + 1} {verb} from {before[joint]:.3f} to "
            f"{after[joint]:.3f} Nm; the noise alone gives {noise[joint]:.3f} Nm."
        )


def in_words(label: dict[str, Any]) -> str:
    """A label on one line: effect and place first, then its numbers with four digits."""
    place = "" if label.get("joint") is None else f" of joint {label['joint']}"
    numbers = [
        f"{name} {_short(value)}"
        for name, value in label.items()
        if name not in ("effect", "joint") and value is not None
    ]
    return f"{label['effect'].replace('_', ' ')}{place}: {', '.join(numbers)}"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_short(item) for item in value) + "]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def names_of(finding: dict[str, Any]) -> list[tuple[str, int | None]]:
    """Effect and joint of a finding, its own first, then those the data could not tell apart."""
    return [(item["effect"], item["joint"]) for item in (finding, *finding["alternatives"])]


def is_right(diagnosis: dict[str, Any], label: dict[str, Any]) -> bool:
    """Whether one finding is there, and it names the hidden effect at its joint, alone or within its alternatives."""
    findings = diagnosis["findings"]
    return len(findings) == 1 and (label["effect"], label["joint"]) in names_of(findings[0])


def judgement(diagnosis: dict[str, Any], label: dict[str, Any]) -> str:
    """The verdict against the truth, in one sentence."""
    truth = (label["effect"], label["joint"])
    named = [names_of(finding) for finding in diagnosis["findings"]]
    if is_right(diagnosis, label):
        return "Named rightly." if named[0][0] == truth else "Within the names that this data cannot tell apart."
    if any(truth in names for names in named):
        return f"Named rightly, among {len(named)} findings; the others are not there."
    return "Not named." if not named else "WRONG: what was named is not what was hidden."


def rms_tables(out: Path, folders: dict[str, str]) -> dict[str, RmsTable]:
    """RMS of the fit and of the extended model on the recordings in these folders of `out`."""
    from identification.mismatch.prediction import validate_with_effects
    from identification.model_file import read_model
    from identification.recordings import read_recording

    tables = {}
    for what, folder in folders.items():
        recording = read_recording(out / folder / "recording.mcap")
        for kind, file in (("", "model.json"), (", effects included", "diagnosis/model.json")):
            tables[what + kind] = validate_with_effects(read_model(out / "excitation" / file), [recording])
    return tables


def prepare_motion_of(trajectory: Any, out: Path) -> PreparedMotion:
    """Write a shipped trajectory into the demo's folder and prepare it as any user's file."""
    from daemon.motion.preparation import prepare_motion

    make_folder(out)
    file = out / "unused-trajectory.json"
    file.write_text(json.dumps(trajectory.to_json(), indent=1) + "\n", encoding="utf-8")
    return prepare_motion(file)


def parameters_in_words(parameters: list[dict[str, Any]], truth: np.ndarray[Any, Any]) -> str:
    """How many of the well-determined parameters lie within 3 σ of the truth."""
    close = [
        abs(item["value"] - true) <= 3.0 * item["std"]
        for item, true in zip(parameters, truth, strict=True)
        if item["std"] < 0.05 * abs(item["value"])
    ]
    return (
        f"{sum(close)} of the {len(close)} parameters whose σ is below 5 % of their value are within 3 σ of the truth."
    )


def show_comparison(
    parameters: list[dict[str, Any]], nominal: list[dict[str, Any]], truth: np.ndarray[Any, Any]
) -> None:
    """Value, σ and truth of each base parameter, and the nominal fit's value, as a table."""
    rows = []
    without = {parameter["name"]: parameter["value"] for parameter in nominal}
    for parameter, true in zip(parameters, truth, strict=True):
        value, std = parameter["value"], parameter["std"]
        rows.append((
            parameter["name"], f"{value:z.5f}", f"{std:.5f}", f"{true:z.5f}", f"{(value - true) / std:+.1f}",
            f"{without[parameter['name']]:z.5f}", parameter["unit"],
        ))  # fmt: skip
    show_table(("parameter", "identified", "σ", "true", "off, in σ", "without effects", "unit"), rows)
