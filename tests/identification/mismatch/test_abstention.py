"""Which names are given up. Truth: the label of a concealed case of a tuning seed."""

from __future__ import annotations

from pathlib import Path

from fixtures.cases.draw import draw_case
from fixtures.cases.files import write_recordings
from identification.mismatch.diagnosis import diagnose
from identification.recordings import read_recording
from identification.robots import RobotModel


def test_a_torque_of_no_known_kind_is_not_written_as_a_sum_of_names(iiwa14: RobotModel, tmp_path: Path) -> None:
    """A cable that rubs along its guide was a spring, an inertia and a drag, none of them missed for much."""
    first, second = (read_recording(path) for path in write_recordings(draw_case(300, 92), tmp_path))
    diagnosis = diagnose([first], iiwa14, heldout=[second])
    assert len(diagnosis.findings) <= 1
    assert "describes part of the misfit" in diagnosis.remaining
