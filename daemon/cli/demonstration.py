"""The command `demo`: the whole chain against a fake robot that hides an effect, and the verdict beside the truth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from daemon.cli.acquisition import show_event, show_preflight
from daemon.cli.analysis import show_certificate
from daemon.cli.app import app
from daemon.cli.diagnosis import VERDICTS
from daemon.cli.output import JsonOption, data, show_table, write_json

if TYPE_CHECKING:
    import numpy as np

    from daemon.api import RunOutcome
    from daemon.preparation import PreparedMotion

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
    out: Annotated[Path, typer.Option("--out", help="Folder for all files.")] = Path("demo-output"),
    periods: Annotated[int, typer.Option("--periods", min=1, help="Periods to record.")] = 16,
    realtime: Annotated[bool, typer.Option("--realtime", help="1 kHz by the clock instead of lockstep.")] = False,
    seed: Annotated[int, typer.Option("--seed", help="Of the fake robot's noise and of what it hides.")] = 1,
    json_file: JsonOption = None,
) -> None:
    """The whole chain without a robot: record over FRI, fit, find what the robot hides, open its seal, compare.

    Example: iiwa-ident demo --seed 7 --out demo-output
    """
    from daemon import demonstration
    from daemon.cli.worker_view import wait_for_worker
    from daemon.preparation import prepare_motion
    from identification.excitation import validation_trajectory

    out = fresh_folder(out)
    motion = prepare_motion(None)
    data(f"1. Motion: {motion.name}, {motion.trajectory.period_s:g} s a period; preflight:")
    show_preflight(motion)
    if not motion.preflight.safe:
        raise typer.Exit(1)

    mode = "in real time at 1 kHz" if realtime else "in lockstep"
    commitments: list[str] = []

    def publish(commitment: str) -> None:
        commitments.append(commitment)
        data(f"   The fake robot hides one effect, drawn from seed {seed}. SHA-256 of its salted label: {commitment}")

    def acquire(chosen: PreparedMotion, name: str, count: int, heldout: tuple[str, ...], fit: bool) -> RunOutcome:
        outcome = demonstration.record(
            chosen, out / name, periods=count, seed=seed if fit else seed + 1, realtime=realtime, fit=fit,
            observe=show_event, hidden_effect=seed, publish=publish, heldout=heldout,
        )  # fmt: skip
        for sentence in outcome.sentences:
            data(f"   {sentence}")
        if outcome.exit_code:
            raise typer.Exit(outcome.exit_code)
        return outcome

    data(f"2. Another motion first, {PERIODS_UNUSED} periods {mode}: what the fit will not see, to check names on")
    unused = acquire(
        prepare_motion_of(validation_trajectory(motion.robot), out), "unused", PERIODS_UNUSED, (), fit=False
    )
    data(f"3. Acquisition: {periods} periods {mode}; the worker fits and diagnoses from the logs alone")
    outcome = acquire(motion, "excitation", periods, unused.recordings, fit=True)
    assert outcome.worker_status_file is not None
    status = wait_for_worker(Path(outcome.worker_status_file))
    if status.phase != "done" or status.diagnosis_error is not None:
        raise typer.Exit(status.exit_code or 1)

    folder = out / "excitation"
    document, extended, diagnosis = (
        json.loads((folder / name).read_text(encoding="utf-8"))
        for name in ("model.json", "diagnosis/model.json", "diagnosis/diagnosis.json")
    )
    data("4. Verdict")
    show_verdict(diagnosis)
    label = demonstration.opened_effect(folder / "fake_robot.json", commitments[-1])
    data("5. The seal is opened; its hash is the one published at the start")
    data(f"   hidden: {in_words(label)}")
    data(f"   {judgement(diagnosis, label)}")

    data("6. Base parameters beside the fake robot's true ones: fitted together with the effects, and without them")
    regressor = demonstration.demo_regressor()
    truth = demonstration.true_base_parameters(folder / "fake_robot.json", regressor)
    show_comparison(extended["base_parameters"], document["base_parameters"], truth)
    data("7. RMS of measured minus modelled torque per joint, Nm, of the base and of the feasible parameters")
    tables = show_rms(out, {"fitted": ("excitation", periods), "unused": ("unused", PERIODS_UNUSED)})
    show_certificate(document["certificate"])
    files = show_files(out)
    if json_file is not None:
        write_json(
            json_file,
            {
                "base_parameters": [
                    {**p, "true": float(t)} for p, t in zip(extended["base_parameters"], truth, strict=True)
                ],
                "rms": tables,
                "verdict": diagnosis["verdict"],
                "findings": diagnosis["findings"],
                "hidden": label,
                "commitment": commitments[-1],
                "right": is_right(diagnosis, label),
                "files": files,
                "seed": seed,
            },
        )


def show_verdict(diagnosis: dict[str, Any]) -> None:
    """Verdict, findings and what remains, as `diagnose` says them."""
    data(f"   {VERDICTS[diagnosis['verdict']]}")
    for finding in diagnosis["findings"]:
        data(f"   - {finding['sentence']}")
    data(f"   {diagnosis['remaining']}")
    heldout = diagnosis["heldout"]
    if heldout is not None:
        for name, key in (("before", "rms_before_nm"), ("after", "rms_after_nm"), ("noise", "noise_floor_nm")):
            data(f"   unused motion, RMS {name:<7s} Nm:" + "".join(f"{value:8.4f}" for value in heldout[key]))


def in_words(label: dict[str, Any]) -> str:
    """A label on one line, numbers with four digits."""
    return ", ".join(f"{name} {_short(value)}" for name, value in label.items() if value is not None)


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


def show_rms(out: Path, recordings: dict[str, tuple[str, int]]) -> dict[str, Any]:
    """RMS tables of the fit and of the extended model on recordings, given as folder and number of periods."""
    from identification.mismatch.prediction import validate_with_effects
    from identification.model_file import read_model
    from identification.recordings import read_recording

    tables = {}
    for what, (folder, averaged) in recordings.items():
        recording = read_recording(out / folder / "recording.mcap")
        for kind, file in (("", "model.json"), (", effects included", "diagnosis/model.json")):
            table = validate_with_effects(read_model(out / "excitation" / file), [recording])
            if not kind:
                data(f"   {what} motion, mean of {averaged} period(s); the noise alone would give:")
                data(f"   {'':24s}" + "".join(f"{floor:8.3f}" for floor in table.rows[0].noise_floor_nm))
            data(f"   the {'extended' if kind else 'nominal'} model{kind}:")
            data(table.text())
            tables[what + kind] = table.to_json()
    return tables


def prepare_motion_of(trajectory: Any, out: Path) -> PreparedMotion:
    """Write a shipped trajectory into the demo's folder and prepare it as any user's file."""
    from daemon.preparation import prepare_motion

    out.mkdir(parents=True, exist_ok=True)
    file = out / "unused-trajectory.json"
    file.write_text(json.dumps(trajectory.to_json(), indent=1) + "\n", encoding="utf-8")
    return prepare_motion(file)


def show_comparison(
    parameters: list[dict[str, Any]], nominal: list[dict[str, Any]], truth: np.ndarray[Any, Any]
) -> None:
    """Value, σ and truth of each base parameter, the nominal fit's value, and how many lie within 3 σ."""
    table = Table("parameter", "identified", "σ", "true", "difference in σ", "without effects", "unit")
    without = {parameter["name"]: parameter["value"] for parameter in nominal}
    within, determined = 0, 0
    for parameter, true in zip(parameters, truth, strict=True):
        value, std = parameter["value"], parameter["std"]
        distance = (value - true) / std
        if std < 0.05 * abs(value):
            determined += 1
            within += abs(distance) <= 3.0
        table.add_row(
            parameter["name"], f"{value:.5f}", f"{std:.5f}", f"{true:.5f}", f"{distance:+.1f}",
            f"{without[parameter['name']]:.5f}", parameter["unit"],
        )  # fmt: skip
    show_table(table)
    data(f"{within} of the {determined} parameters whose σ is below 5 % of their value are within 3 σ of the truth.")


def show_files(out: Path) -> list[str]:
    """Print where everything is, and return it."""
    files = sorted(path for path in out.rglob("*") if path.is_file() and not path.name.startswith("."))
    data("Files:")
    for file in files:
        data(f"  {file}  ({file.stat().st_size / 1e6:.2f} MB)")
    return [str(file) for file in files]
