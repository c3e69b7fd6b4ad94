"""What the audit of the set-up means for the rest of a diagnosis: the gravity it is made under, and its verdict. Pure.

Not here: the audit (`identification.audit`), and what any recording shows of its set-up without a model (`set_up`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from identification.audit import Audit
from identification.audit.mount import other_stand
from identification.errors import RecordingError
from identification.mismatch.baseline import ModelComparison
from identification.mismatch.findings import Diagnosis
from identification.model_file import Model
from identification.recordings.recording import Recording
from identification.robots import RobotModel


def under_their_gravity(
    robot: RobotModel, recordings: Sequence[Recording], audited: Audit | None
) -> tuple[RobotModel, str]:
    """The robot as recordings that were compared with a model show it to stand, and a sentence where that is not as
    stated: free parameters fitted under the wrong gravity leave much, which is neither noise nor missing physics.

    What a recording shows without a model goes first: it is the gravity under which free parameters leave least. The
    audit's stands in for it where a turn is too small for that, or where the data are not as they were read.
    """
    if audited is None:
        return robot, ""
    found = None
    if all(item.against == "model" for item in audited.differences):
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
    stand: str,
) -> Diagnosis:
    """With what of the given model is wrong: its parameters, or the set-up where that settles it. stand: as of
    `under_their_gravity`; under another gravity than the model's no parameters are compared.
    """
    if isinstance(model, Model):
        compared = replace(compared, fitted_to=model.fitted_among(recordings))
    compared = replace(compared, set_up=audited.sentence if audited is not None and audited.settles else stand)
    return replace(diagnosis, model_comparison=compared, notes=(compared.sentence, *diagnosis.notes), audit=audited)


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
