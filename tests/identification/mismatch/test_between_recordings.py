"""Recordings that disagree, and recordings that do not tell their noise. Truth: Pinocchio's inverse dynamics.

A load of 3 kg at the flange is put on for the held-out run only: its torque is that of a point mass, added to the last
link by the parallel-axis theorem.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from daemon.cli.diagnosis import NOT_MEASURED, verdict_lines
from identification.audit import Audit, Difference
from identification.mismatch import diagnosis as diagnosis_module
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.findings import Diagnosis
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.report.diagnosis_sections import tone_of, verdict_sentence
from identification.robots import RobotModel
from tests.identification.mismatch.plant import NOISE_NM, PERIOD_S, SAMPLES, record
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

MASS, PLACE = 3.0, np.array([0.02, 0.0, 0.15])


def loaded(arm: PhysicalParameters) -> PhysicalParameters:
    mass, center, inertia = arm.mass.copy(), arm.center_of_mass.copy(), arm.inertia.copy()
    total = mass[6] + MASS
    center[6] = (mass[6] * center[6] + MASS * PLACE) / total
    offset = PLACE - arm.center_of_mass[6]
    reduced = mass[6] * MASS / total
    inertia[6] += reduced * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    mass[6] = total
    return replace(arm, mass=mass, center_of_mass=center, inertia=inertia)


def named(recording: Recording, name: str) -> Recording:
    return replace(recording, source=replace(recording.source, path=f"runs/{name}"))


def one_against_other(
    robot: RobotModel, first: PhysicalParameters, second: PhysicalParameters, periods: int
) -> Diagnosis:
    fitted = named(record(robot, first, periods=periods), "bare/recording.mcap")
    unseen = named(record(robot, second, periods=max(1, periods // 2), motion=9, seed=2), "other/recording.mcap")
    return diagnose([fitted], robot, heldout=[unseen])


@pytest.mark.parametrize("periods", [8, 1])
def test_a_load_on_the_held_out_run_alone_is_a_difference_between_the_recordings(
    iiwa14: RobotModel, table3: PhysicalParameters, periods: int
) -> None:
    """Also where no noise is measured: the fitted misfit is then the measure."""
    diagnosis = one_against_other(iiwa14, table3, loaded(table3), periods)
    # Nothing but the load differs, and it is named.
    assert diagnosis.verdict == "explained"
    assert not diagnosis.findings
    assert not diagnosis.data_faults
    assert not diagnosis.baseline.detected.any()
    assert diagnosis.heldout is not None
    worst = diagnosis.heldout.misfits[0]
    assert (worst.recording, worst.joint, worst.differs) == ("other/recording.mcap", 2, True)
    # Gravity alone: 3 kg at up to a metre from the second axis.
    assert 5.0 < worst.rms_nm < 30.0
    assert "Something differs between the fitted recordings and other/recording.mcap" in diagnosis.remaining
    assert "Joint 2: " in diagnosis.remaining
    assert verdict_lines(diagnosis)[-1].startswith("Explained: the recordings differ by what is named here")
    assert diagnosis.audit is not None
    load = diagnosis.audit.differences[0]
    assert load.effect == "payload"
    low, high = load.numbers[0].interval
    assert low < MASS < high
    # Two runs that are both called recording.mcap: the sentence has to say against which.
    assert "bare/recording.mcap" in load.sentence
    # What these rows cannot tell from it, in words and not as names of effects.
    assert "or as likely" in load.sentence
    assert "a load on link 6" in load.sentence
    assert "_" not in load.sentence
    assert "stands above" in verdict_lines(diagnosis)[-1]
    assert "`iiwa-ident payload`" in verdict_lines(diagnosis)[-1]
    assert "held-out recordings" in verdict_sentence(diagnosis)
    assert load.sentence in verdict_sentence(diagnosis)
    assert diagnosis.to_json()["heldout"]["misfits"][0]["joint"] == 2


@pytest.mark.parametrize("periods", [8, 1])
def test_recordings_of_the_same_arm_agree(iiwa14: RobotModel, table3: PhysicalParameters, periods: int) -> None:
    diagnosis = one_against_other(iiwa14, table3, table3, periods)
    assert diagnosis.verdict == "no_mismatch"
    assert diagnosis.heldout is not None
    assert not diagnosis.heldout.misfits


def test_what_a_small_motion_leaves_open_is_no_difference_between_recordings(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """One period of a third of the motion, whose parameters scatter by 0.03 Nm on the other run of the same arm. That
    scatter was counted as of noise of a tenth of what the fit leaves, and the recordings were said to disagree.
    """
    q, dq, ddq = (0.3 * part for part in fourier_motion(7, period_s=PERIOD_S, samples=SAMPLES, seed=3))
    noise = NOISE_NM * np.random.default_rng(1).normal(size=q.shape)
    fitted = recording_of(q, inverse_dynamics(iiwa14, table3, q, dq, ddq) + noise, period_s=PERIOD_S, periods=1)
    diagnosis = diagnose([fitted], iiwa14, heldout=[record(iiwa14, table3, motion=9, seed=2)])
    assert diagnosis.heldout is not None
    assert not diagnosis.heldout.misfits
    assert diagnosis.verdict == "no_mismatch"


def test_of_one_period_nothing_is_told_of_noise(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    """Noise that is stronger at low frequencies, as real torque sensors have it: its high band says too little."""
    recording = record(iiwa14, table3, periods=1)
    slow = np.cumsum(np.random.default_rng(3).normal(scale=0.02, size=recording.torque.shape), axis=0)
    diagnosis = diagnose([replace(recording, torque=recording.torque + slow - slow.mean(axis=0))], iiwa14)
    assert diagnosis.verdict == "undecided"
    assert not diagnosis.baseline.noise_is_measured
    assert not diagnosis.baseline.detected.any()
    assert not diagnosis.findings
    assert verdict_lines(diagnosis)[0].startswith(NOT_MEASURED.partition("{")[0])
    # One figure of what is left, the fit's: the sentence at the end gave that of the compared band, a third of it.
    rms = ", ".join(f"{value:.2g}" for value in diagnosis.rms_after_nm)
    assert rms in verdict_lines(diagnosis)[0]
    assert f"The model leaves {rms} Nm RMS by joint" in diagnosis.remaining
    assert "none is ruled out" in verdict_sentence(diagnosis)
    assert tone_of(diagnosis) == "neutral"
    assert diagnosis.to_json()["baseline"]["noise_is_measured"] is False


@pytest.mark.parametrize(("taken", "named"), [((0.72,), False), ((0.24,), False), ((0.6, 0.35), True), ((0.97,), True)])
def test_another_set_up_is_named_only_where_it_is_all_that_differs(
    monkeypatch: pytest.MonkeyPatch, taken: tuple[float, ...], named: bool
) -> None:
    """A flexible base was another link (72 % of the difference), friction that thins another friction (24 %)."""
    differences = tuple(Difference("payload", None, 7, (), share, 50.0, "model", "A load.") for share in taken)
    found = Audit("a.npz", "named", differences, (1.0,) * 7, (0.1,) * 7, "A load.")
    monkeypatch.setattr(diagnosis_module, "_audited", lambda *_: found)
    monkeypatch.setattr(diagnosis_module, "model_of_fit", lambda *_: None)
    monkeypatch.setattr(diagnosis_module, "recording_names", lambda items: ["a.npz"] * len(items))
    said = SimpleNamespace(classes=(), heldout=SimpleNamespace(misfits=(SimpleNamespace(differs=True, joint=2),)))
    rows = SimpleNamespace(fit=object(), fitted=[None], unseen=[None])
    answer = diagnosis_module._other_set_up(said, rows, None)  # type: ignore[arg-type]
    assert (answer is found) is named


def test_one_run_is_noisier_than_a_mean_of_periods_and_nothing_differs(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """The same arm twice: 16 periods, and a run that states none. "Something differs" was said of each joint."""
    fitted = named(record(iiwa14, table3, periods=16), "periods/recording.mcap")
    run = record(iiwa14, table3, periods=2, motion=9, seed=2)
    unseen = named(
        replace(run, period_s=None, period_index=None, sample_in_period=None, samples_per_period=None), "run/one.mcap"
    )
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    assert diagnosis.heldout is not None
    assert not diagnosis.heldout.misfits
