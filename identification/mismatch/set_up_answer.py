"""What the audit of the set-up means for the rest of a diagnosis: the gravity it is made under, how its recordings are
read, and its verdict. Pure.

Not here: the audit (`identification.audit`), and what any recording shows of its set-up without a model (`set_up`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from identification.audit import Audit
from identification.audit.mount import other_stand
from identification.audit.reading import Reading, read_so
from identification.errors import RecordingError
from identification.fitting.result import FitResult
from identification.mismatch.baseline import ModelComparison
from identification.mismatch.findings import Diagnosis
from identification.model_file import Model
from identification.recordings.recording import Recording
from identification.robots import RobotModel
from identification.validation import validate_model

AS_READ = "What follows is of the recordings with what is wrong in their data, by the set-up, put right."


def under_their_gravity(
    robot: RobotModel, recordings: Sequence[Recording], audited: Audit | None
) -> tuple[RobotModel, str]:
    """The robot as recordings that were compared with a model show it to stand, and a sentence where that is not as
    stated: free parameters fitted under the wrong gravity leave much, which is neither noise nor missing physics.

    recordings: as the audit reads them. What these show without a model goes first: it is the gravity under which free
    parameters leave least. The audit's stands in for it where a turn is too small for that.
    """
    if audited is None:
        return robot, ""
    try:
        found = other_stand(recordings, robot)
    except RecordingError:  # joints that are exchanged or turned look like another stand
        found = None
    if found is not None:
        return replace(robot, gravity=found[1].gravity), found[1].taken
    turn = next((item for item in audited.differences if item.effect == "base_tilt"), None)
    if turn is None:
        return robot, ""
    numbers = {item.name: item.value for item in turn.numbers}
    gravity = np.array([numbers[f"gravity_{axis}"] for axis in "xyz"])
    x, y, z = (f"{value:z.2f}" for value in gravity.tolist())
    return replace(robot, gravity=gravity), f"Gravity is taken as named: ({x}, {y}, {z}) m/s² in the frame of the base."


def with_model(
    diagnosis: Diagnosis,
    compared: ModelComparison,
    model: Model | Path,
    recordings: Sequence[Recording],
    audited: Audit | None,
    found: tuple[RobotModel, str],
) -> Diagnosis:
    """With what of the given model is wrong: its parameters, or the set-up where that settles it. found: as of
    `under_their_gravity`; under another gravity than the model's no parameters are compared.
    """
    robot, stand = found
    if isinstance(model, Model):
        compared = replace(compared, fitted_to=model.fitted_among(recordings))
    compared = replace(compared, set_up=audited.sentence if audited is not None and audited.settles else stand)
    if stand:
        diagnosis = replace(diagnosis, gravity=tuple(robot.gravity.tolist()), notes=(stand, *diagnosis.notes))
    reading = None if audited is None or audited.reading is None or not audited.reading.is_other else audited.reading
    notes = (*(() if reading is None else (AS_READ,)), compared.sentence, *diagnosis.notes)
    return _answered(replace(diagnosis, model_comparison=compared, notes=notes, audit=audited, reading=reading))


def unseen_as_read(
    reading: Reading | None, heldout: Sequence[Recording], robot: RobotModel, fit: FitResult | None
) -> Sequence[Recording]:
    """Held-out recordings read as the fitted ones are; as it stands each of which their fit leaves less so.

    It may be of another day, and none was asked beside the model.
    """
    if reading is None or not reading.is_other:
        return heldout
    read = read_so(reading, heldout, robot)
    return read if fit is None else [min(pair, key=partial(_misfit, fit)) for pair in zip(read, heldout, strict=True)]


def _misfit(fit: FitResult, recording: Recording) -> float:
    """What a fit leaves of another recording over what it leaves of its own, all joints together."""
    left, own = (table.rows[0].rms_nm for table in (validate_model(fit, [recording]), fit.rms))
    return float(np.sum((left / np.maximum(own, 1e-300)) ** 2))


def settled(diagnosis: Diagnosis) -> Diagnosis:
    """Explained, where the held-out recordings alone disagree, and what differs in their set-up is named and is all."""
    audit, heldout = diagnosis.audit, diagnosis.heldout
    if audit is None or heldout is None or not (audit.verdict == "named" and audit.holds):
        return diagnosis
    stays = (
        bool(diagnosis.curves)
        or not all(item.named for item in diagnosis.classes)
        or not all(item.differs for item in heldout.misfits)
    )
    unnamed = not diagnosis.findings and bool(diagnosis.baseline.detected.any())
    if stays or unnamed or diagnosis.verdict not in ("unexplained", "partly_explained"):
        return diagnosis
    known = f"{audit.sentence} With that put in, nothing above the noise remains."
    return replace(diagnosis, verdict="explained", remaining=f"{known} {diagnosis.remaining}")


def _answered(diagnosis: Diagnosis) -> Diagnosis:
    """With the set-up's verdict, where that names what differs from a given model and nothing besides is claimed.

    What free parameters leave may still be noise or missing physics; it is not what the model and the arm differ by.
    """
    audit = diagnosis.audit
    if audit is None or not audit.differences or diagnosis.verdict not in ("no_mismatch", "undecided"):
        return diagnosis
    whole = audit.verdict == "named" and audit.holds
    return replace(diagnosis, verdict="explained" if whole else "partly_explained")


def set_up_sentences(diagnosis: Diagnosis) -> tuple[str, ...]:
    """What an audit says, said before anything that a fit of these recordings says; empty where none was asked."""
    audit = diagnosis.audit
    return () if audit is None else tuple(item.sentence for item in audit.differences or (audit,))


def set_up_verdict(diagnosis: Diagnosis) -> str:
    """The verdict in words where the set-up alone makes it (`_answered`); else empty."""
    audit = diagnosis.audit
    if audit is None or diagnosis.model_comparison is None or not audit.differences:
        return ""
    if diagnosis.findings or diagnosis.unnamed:
        return ""
    if diagnosis.verdict == "explained":
        return (
            f"Explained: these recordings differ from {audit.source} in their set-up, by what is named. With that put "
            "right, it leaves no more than a model that holds."
        )
    if diagnosis.verdict == "partly_explained":
        return f"Partly explained: what is named of the set-up is there, but more differs from {audit.source}."
    return ""
