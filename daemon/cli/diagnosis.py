"""The commands `diagnose` and `batch`: what is missing in the model, in words first; many recordings at once."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli import inputs as read
from daemon.cli.app import app
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption, data, data_lines, message, show_table, told_in_words
from daemon.cli.progress import progress_shown
from daemon.cli.protection import folder_to_write, not_a_recording
from daemon.jobs.batch import Task

if TYPE_CHECKING:
    from daemon.jobs.batch import BatchItem
    from identification.mismatch.effects.base import Parameter
    from identification.mismatch.findings import Diagnosis, Finding
    from identification.robots import RobotModel

VERDICTS = {
    "no_mismatch": "No mismatch: the nominal model explains these recordings down to their noise.",
    "explained": "Explained: with what is named here, nothing but noise remains.",
    "partly_explained": "Partly explained: what is named here is there, but it is not all.",
    "unexplained": "Unexplained: there is a mismatch, and nothing known to this program explains it.",
    "undecided": "Undecided: what the model leaves is a great deal, and may be noise or missing physics.",
}


NOT_MEASURED = (
    "The noise was not measured: that takes a recording of two periods or more. How much of the misfit, {left} Nm "
    "RMS by joint, is noise cannot be told. Effects near the noise cannot be found, nor what changes from period to "
    "period (drift, pushes)."
)
WITHOUT_NAME = "Unexplained: there is a mismatch without a name. What the torque depends on is said instead."
TOO_WEAK = (
    "Unexplained: something is there, and it is too weak in these recordings for a name. What fits it is said below."
)
DISAGREE = "Unexplained: the model holds on the fitted recordings and not on the held-out ones; something differs."
NAMED = "What differs between the recordings stands above, under Set-up; the model itself is not in question."
SETTLED = "Explained: the recordings differ by what is named here, and with that put in nothing but noise remains."


@app.command()
@grouped
def diagnose(
    logs: read.LogsArgument,
    *,
    heldout: Annotated[
        list[Path] | None,
        typer.Option("--heldout", help="Recording of another motion that checks every name; may be given repeatedly."),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="MODEL.json|FILE.urdf", help="Also: what of this model is wrong."),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option("--split", metavar="SPLIT", help="Without periods: rows held out, 'first:0.6' or 'blocks:0.5:3'."),
    ] = None,
    low_pass_hz: Annotated[
        float | None,
        typer.Option("--low-pass-hz", min=0.1, help="Without periods: band compared; default: that of the fit."),
    ] = None,
    write_model: Annotated[
        Path | None,
        typer.Option(
            "--write-model",
            metavar="FILE",
            help="With --model: that file with what was found written in.",
            callback=not_a_recording,
        ),
    ] = None,
    arm: read.RecordedArm,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Default: diagnosis/ beside the log.", callback=folder_to_write),
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Locate what the model leaves out, name it, model it, and check it on recordings not used for that.

    Exit code 0 whatever the verdict; the verdict is the result, on the first line and in diagnosis.json.
    Example: iiwa-ident diagnose runs/first/recording.mcap --heldout runs/second/recording.mcap --out diagnosis
    """
    from daemon.jobs.diagnosis import diagnose_recordings, write_model_back
    from identification.errors import EstimationError
    from identification.fitting.settings import Split
    from identification.mismatch.settings import DiagnosisSettings
    from identification.recordings.reader import recording_file
    from identification.signals.alike import one_of_alike

    if write_model is not None:
        _refuse_as_target(write_model, model)
    if split is not None:
        with read.as_usage(EstimationError):
            Split.parse(split)
    inputs = arm.load(
        [*logs, *(heldout or ())],
        fits=model is None,  # against a model, how the base stands is one of the answers
        model_robot=None if model is None else robot_of_model(model),
    )
    recordings, unseen = inputs.recordings[: len(logs)], inputs.recordings[len(logs) :]
    periodic = [one_of_alike(recording).repeats for recording in (*recordings, *unseen)]
    if split is not None and (unseen or any(periodic)):
        raise typer.BadParameter("--split is for recordings without periods, where no --heldout is given.")
    if low_pass_hz is not None and all(periodic):
        raise typer.BadParameter("--low-pass-hz is for recordings without periods; these have lines to choose from.")
    with progress_shown() as show:
        result = diagnose_recordings(
            recordings,
            unseen,
            inputs.robot,
            out or recording_file(logs[0]).with_name("diagnosis"),
            baseline=model,
            settings=DiagnosisSettings(split=split, low_pass_hz=low_pass_hz),
            progress=show,
        )
    in_words = told_in_words(result.diagnosis.to_json(), json_file)
    if in_words:
        show_diagnosis(result.diagnosis)
        data_lines(f"Written to {file}" for file in result.files)
    # Last: where a file cannot be changed, what was found is said all the same.
    if write_model is not None and model is not None and result.diagnosis.audit is not None:
        found, reading = result.diagnosis.audit.differences, result.diagnosis.reading
        written = write_model_back(recordings, inputs.robot, model, found, write_model, reading)
        if in_words:
            data_lines(
                (*(f"Model: {line}" for line in written.lines), *(f"Written to {file}" for file in written.files))
            )


def _refuse_as_target(target: Path, model: Path | None) -> None:
    """Raises a usage error for a file that no changed model can be written to."""
    if model is None or model.suffix == ".json":
        raise typer.BadParameter("--write-model needs a simulator's file (.urdf, .sdf, .xml) with --model.")
    if target.resolve() == model.resolve():
        raise typer.BadParameter("--write-model would write over the file of --model: give another name.")
    if target.suffix.lower() != model.suffix.lower():
        raise typer.BadParameter(f"--write-model {target}: a changed model keeps its format, {model.suffix}.")


def robot_of_model(file: Path) -> RobotModel | None:
    """The robot that a model.json is of; None for a simulator's file, which has its own kinematics."""
    from identification.model_file import read_model

    return read_model(file).load_robot() if file.suffix == ".json" else None


def show_diagnosis(diagnosis: Diagnosis) -> None:
    """The verdict, each finding as a sentence with its numbers, what remains, and RMS per joint, on stdout."""
    from identification.mismatch.between_recordings import one_a_line

    data_lines(set_up_lines(diagnosis))
    data_lines(verdict_lines(diagnosis))
    remaining = diagnosis.remaining
    for fault in diagnosis.data_faults:
        data(f"Data: {fault.sentence}")
        remaining = remaining.removeprefix(fault.sentence).lstrip()
    for number, finding in enumerate(diagnosis.findings, start=1):
        data(f"{number}. {finding.sentence}")
        data_lines(f"   {line}" for line in finding_lines(finding, diagnosis.torque_units))
    data_lines(claim.sentence for claim in diagnosis.unnamed)
    data_lines(one_a_line(remaining))
    show_joints(diagnosis)
    data_lines(f"note: {note}" for note in diagnosis.notes)


def set_up_lines(diagnosis: Diagnosis) -> Sequence[str]:
    """What differs between the given model and the arm, before anything that a fit of these recordings says."""
    from identification.mismatch.set_up_answer import set_up_sentences

    compared = diagnosis.model_comparison
    no_check = () if compared is None else compared.no_check
    return [*no_check, *(f"Set-up: {sentence}" for sentence in set_up_sentences(diagnosis))]


def verdict_lines(diagnosis: Diagnosis) -> Sequence[str]:
    """What is said first: whether noise was measured at all, then the verdict."""
    from identification.mismatch.set_up_answer import set_up_verdict
    from identification.robots.joint_units import in_units

    baseline, heldout = diagnosis.baseline, diagnosis.heldout
    unknown = NOT_MEASURED.format(left=", ".join(f"{value:.2g}" for value in diagnosis.rms_after_nm))
    unknown = in_units(unknown, diagnosis.torque_units)
    if not baseline.noise_is_measured and diagnosis.verdict == "no_mismatch":
        return [f"{unknown} No mismatch is shown, and none is ruled out."]
    sentence = set_up_verdict(diagnosis) or VERDICTS[diagnosis.verdict]
    differs = heldout is not None and any(item.differs for item in heldout.misfits)
    of_heldout = differs and diagnosis.model_comparison is None
    named = () if diagnosis.audit is None or not of_heldout else diagnosis.audit.differences
    if diagnosis.verdict == "explained" and named:
        sentence = f"{SETTLED} {NAMED}"
    elif diagnosis.verdict == "unexplained" and differs and not baseline.detected.any():
        sentence = f"{DISAGREE} {NAMED}" if named else DISAGREE
    elif diagnosis.verdict == "unexplained" and diagnosis.unnamed:
        sentence = WITHOUT_NAME
    elif diagnosis.verdict == "unexplained" and diagnosis.too_weak and not differs:
        sentence = TOO_WEAK
    elif differs:
        sentence += " The held-out recordings disagree with the fitted ones."
    if any(item.effect == "payload" for item in named):
        sentence += " `iiwa-ident payload` weighs a load more exactly."
    return [sentence] if baseline.noise_is_measured else [unknown, sentence]


def finding_lines(finding: Finding, torque_units: Sequence[str] = ()) -> Sequence[str]:
    """Numbers of one finding: parameters with σ, how sure, how much of it base parameters hide, held-out gain.

    torque_units: of each joint, empty: all Nm.
    """
    from identification.report.numbers import chance
    from identification.robots.joint_units import in_units

    lines = [
        "; ".join(_in_numbers(item) for item in finding.parameters),
        f"score {finding.score:.0f}, probability by noise alone {chance(finding.significance)}, "
        f"{100 * finding.absorbed_fraction:.0f} % of it would be taken up by the base parameters",
    ]
    if finding.heldout_gain_nm.size:
        gain = ", ".join(f"{1e3 * value:z.1f}" for value in finding.heldout_gain_nm)
        count = finding.heldout_gain_nm.size
        joints = "joint 1" if count == 1 else f"joints 1 to {count}"
        raised = " (below zero: raises it)" if "-" in gain else ""
        lines.append(in_units(f"lowers the held-out RMS of {joints} by {gain} mNm{raised}", torque_units))
    if finding.separating_experiment:
        lines.append(f"To tell them apart: {finding.separating_experiment}")
    return lines


def _in_numbers(parameter: Parameter) -> str:
    """Value and σ; ± is left to the sentences, where it is half of the 95 % interval. The unit 1 is none to read."""
    from identification.report.numbers import UNKNOWN, with_sigma

    value, sigma = with_sigma(parameter.value, parameter.std)
    text = f"{parameter.name} {value} {'' if parameter.unit == '1' else parameter.unit}".rstrip()
    return text if sigma == UNKNOWN else f"{text} (σ {sigma})"


def show_joints(diagnosis: Diagnosis) -> None:
    """Print RMS per joint before and after, with the noise floor, of the fitted and of the held-out recordings.

    The extended model has torque without a name too; where none is offered it is that with the findings.
    """
    units = diagnosis.torque_units or ("Nm",) * diagnosis.baseline.rms_nm.size
    rows = [("fitted, nominal model", diagnosis.baseline.rms_nm)]
    measured, named = diagnosis.baseline.noise_is_measured, bool(diagnosis.findings)
    if named:
        rows.append(("fitted, with findings", diagnosis.rms_after_nm))
    if measured:
        rows.append(("fitted, noise", diagnosis.baseline.noise_floor_nm))
    if diagnosis.heldout is not None:
        rows.append(("held out, nominal model", diagnosis.heldout.rms_before_nm))
        if named:
            rows.append(("held out, with findings", diagnosis.heldout.rms_after_nm))
        if diagnosis.offer is not None:
            rows.append(("held out, extended model", diagnosis.offer.heldout_rms))
        if measured:
            rows.append(("held out, noise", diagnosis.heldout.noise_floor_nm))
    show_table(
        ("RMS", *(f"joint {joint}, {unit}" for joint, unit in enumerate(units, start=1))),
        [(name, *(f"{value:.4f}" for value in values)) for name, values in rows],
    )


@app.command()
def batch(
    task: Annotated[Task, typer.Argument(help="fit or diagnose.")],
    files: Annotated[list[Path], typer.Argument(help="Recordings, one job each.")],
    heldout: Annotated[
        list[Path] | None, typer.Option("--heldout", help="Of diagnose: recording that checks the names in every file.")
    ] = None,
    robot: read.RobotOption = None,
    joints: read.JointsOption = None,
    lock: read.LockOption = None,
    mount: read.MountOption = None,
    gravity: read.GravityOption = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="A folder for each file in it.", callback=folder_to_write)
    ] = Path("batch"),
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Dask cluster, such as tcp://10.0.0.5:8786.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", min=1, help="At a time on this machine; default: processors.")
    ] = None,
    json_file: JsonOption = None,
) -> None:
    """Fit or diagnose many recordings at once; exit code 1 if any failed, and the others are done all the same.

    On a cluster the files have to lie at the same path on every machine.
    Example: iiwa-ident batch diagnose runs/*/recording.mcap --out batch
    """
    from daemon.jobs.batch import executor_of, run_batch
    from daemon.jobs.batch_summary import write_summary

    with progress_shown(lines=False) as show, executor_of(scheduler, jobs) as executor:
        done = count(1)

        def ended(item: BatchItem) -> None:
            show(f"{task} of {len(files)} recordings", next(done) / len(files))
            message(f"{item.name}: {'failed: ' if item.exit_code else ''}{item.sentence}")

        items = run_batch(
            task, files, out, executor, robot=robot, heldout=heldout or (), joints=read.names_of(joints),
            installation=read.installation_of(gravity, mount, lock), progress=ended,
        )  # fmt: skip
    page, table = write_summary(task, items, out)
    if told_in_words([item.to_json() for item in items], json_file):
        if not (sys.stdout.isatty() and sys.stderr.isatty()):  # there each stands above already
            data_lines(f"{'failed' if item.exit_code else 'done  '}  {item.name}: {item.sentence}" for item in items)
        data(f"As a table: {table}")
        data("The page to open:")
        data(f"  {page}")
    if any(item.exit_code for item in items):
        raise typer.Exit(1)
