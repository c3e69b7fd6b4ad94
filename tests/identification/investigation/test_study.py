"""Claims about the model that hypotheses are weighed beside. Truth: the columns of the one that the diagnosis names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.base_parameters import BaseRegressor, RegressorOptions
from identification.excitation import iiwa_limits
from identification.investigation import assessment, screening, study
from identification.investigation.columns import forms_of
from identification.investigation.experiments import Room, experiment
from identification.mismatch.findings import Baseline, DataFault, Diagnosis
from identification.mismatch.reduction import build_evidence
from identification.mismatch.settings import DiagnosisSettings
from identification.robots import RobotModel
from tests.identification.investigation.test_assessment import evidences


def diagnosis_beside(options: RegressorOptions, faults: tuple[DataFault, ...] = ()) -> Diagnosis:
    """A diagnosis without findings, beside the nominal model of these options."""
    unknown = np.zeros(7)
    baseline = Baseline(unknown, unknown, unknown, unknown, unknown, unknown > 0.0)
    chosen = {"regressor": options.to_json(), "low_pass_hz": None}
    return Diagnosis(
        "iiwa14", "unexplained", "background", baseline, (), faults, (), (), None, (), "", provenance=chosen
    )


@pytest.mark.parametrize(
    "options", [RegressorOptions(offset=True), RegressorOptions(rotor_inertia=True, coulomb_velocity=0.05)]
)
def test_hypotheses_are_weighed_beside_the_nominal_model_of_the_diagnosis(
    tmp_path: Path, iiwa14: RobotModel, iiwa14_base: BaseRegressor, options: RegressorOptions
) -> None:
    (recorded,) = evidences(tmp_path, iiwa14, iiwa14_base, background=False, spring=0.0)
    fault = DataFault("inverted_torque_sign", (2,), "", recording=recorded.recording.source.path)
    diagnosis = diagnosis_beside(options, (fault,))
    regressor, values, (rows,) = study.weighed_rows(
        diagnosis, [recorded.recording], [None], iiwa14, DiagnosisSettings()
    )
    (wanted,) = build_evidence(recorded.recording, iiwa14, BaseRegressor(iiwa14, options))
    np.testing.assert_array_equal(rows.nominal, wanted.nominal)
    np.testing.assert_allclose(rows.torque, wanted.torque * np.array([1, -1, 1, 1, 1, 1, 1]), atol=1e-12)
    assert rows.motion.coulomb_velocity == options.coulomb_velocity
    assert regressor.options == options
    assert len(values) == regressor.size


def test_a_name_that_is_mostly_an_offset_is_not_foretold_where_the_diagnosis_fits_offsets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, iiwa14: RobotModel, iiwa14_base: BaseRegressor
) -> None:
    """Friction that differs between two directions has a mean. Beside offsets that is none of it, and λ is below 60."""
    form = ("asymmetric_viscous_friction", 3)
    monkeypatch.setattr(assessment, "MOST_WEIGHED", 1)
    monkeypatch.setattr(
        screening, "forms_of", lambda motion: (one for one in forms_of(motion) if (one[0].name, one[1].joint) == form)
    )
    (recorded,) = evidences(tmp_path, iiwa14, iiwa14_base, background=False, spring=0.0, asymmetric=0.0036)
    motion = experiment(np.random.default_rng(2), Room(iiwa_limits("iiwa14"), np.zeros(7)), "slow_sweep", 5)
    for offset in (False, True):
        diagnosis = diagnosis_beside(RegressorOptions(offset=offset))
        monkeypatch.setattr(study, "diagnose", lambda *_, found=diagnosis, **__: found)
        found = study.study([recorded.recording], iiwa14)
        assert (found.assessment.leader.effect, found.assessment.leader.place.joint) == form
        foretold = found.chooser.foretell(motion, 4)
        assert foretold.named_now == pytest.approx(0.0 if offset else 1.0, abs=0.05)
