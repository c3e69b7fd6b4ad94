"""Claims about classes, on plants computed by Pinocchio with torque written here, and on robots nobody here built."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.linalg import eigh

from daemon.cli.diagnosis import show_diagnosis
from identification.arrays import FloatArray
from identification.errors import ModelFileError
from identification.mismatch.diagnosis import diagnose
from identification.mismatch.evidence import Evidence
from identification.mismatch.extended_model import extended_model
from identification.mismatch.findings import Diagnosis
from identification.mismatch.heldout import Residuals
from identification.mismatch.prediction import validate_with_effects
from identification.mismatch.unknown import judgement
from identification.mismatch.unknown.forms import rms_interval
from identification.mismatch.unknown.functions import smooth_table
from identification.mismatch.unknown.left import Left
from identification.mismatch.unknown.model_terms import terms_torque
from identification.mismatch.unknown.predictive import Dropped
from identification.mismatch.unknown.selection import Selection
from identification.model_file import read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import fit_recordings
from identification.recordings import read_recording
from identification.report.class_section import class_section
from identification.robots import RobotModel, load_robot
from identification.validation import validate_model
from tests.identification.mismatch.plant import NOISE_NM, on_joint, record
from tests.reference import recording_file


def hump(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """A smooth hump over the position of joint 3 that no effect of the library has the form of."""
    del dq, torque
    return on_joint(3, 0.3 / (1.0 + ((q[:, 2] - 0.1) / 0.3) ** 4))


@pytest.fixture(scope="module")
def humped(iiwa14: RobotModel, table3: PhysicalParameters) -> Diagnosis:
    # Of these two motions of joint 3 the one that is fitted holds the other's range.
    fitted = record(iiwa14, table3, hump, motion=9)
    unseen = record(iiwa14, table3, hump, periods=4, motion=3, seed=2)
    return diagnose([fitted], iiwa14, heldout=[unseen])


def test_a_torque_of_no_known_form_is_given_its_class_on_its_joint_and_no_other(humped: Diagnosis) -> None:
    assert {(claim.name, claim.joint) for claim in humped.classes} == {("own_position", 3)}
    (claim,) = humped.classes
    assert claim.significance > 8.0
    assert claim.interval_nm[0] < claim.rms_nm < claim.interval_nm[1]


@pytest.fixture(scope="module")
def faint(iiwa14: RobotModel, table3: PhysicalParameters) -> Diagnosis:
    """The hump so small that no joint's misfit stands out of its noise, summed over all lines."""

    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return 0.2 * hump(q, dq, torque)

    fitted = record(iiwa14, table3, hidden, motion=9)
    return diagnose([fitted], iiwa14, heldout=[record(iiwa14, table3, hidden, periods=4, motion=3, seed=2)])


@pytest.mark.parametrize("name", ["humped", "faint"])
def test_a_class_is_a_mismatch_and_is_said_in_the_terminal(
    name: str, request: pytest.FixtureRequest, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was: "No mismatch: the nominal model explains these recordings", beside a class of 30 nats in the file."""
    diagnosis: Diagnosis = request.getfixturevalue(name)
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.unnamed == diagnosis.classes != ()
    assert diagnosis.baseline.detected[2]
    show_diagnosis(diagnosis)
    said = capsys.readouterr().out
    assert said.startswith("Unexplained: there is a mismatch without a name.")
    assert said.count("Joint 3: a torque that depends on its own position") == 1
    assert "No mismatch" not in said
    assert "names no cause" not in said


def test_a_class_that_a_name_takes_is_no_mismatch_of_its_own(iiwa14: RobotModel, table3: PhysicalParameters) -> None:
    def spring(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del dq, torque
        return on_joint(3, 0.3 * q[:, 2])

    def both(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return spring(q, dq, torque) + 0.2 * on_joint(5, hump(q[:, [0, 1, 4]], dq, torque)[:, 2])

    recordings = {
        hidden: (record(iiwa14, table3, hidden, motion=9), record(iiwa14, table3, hidden, periods=4, motion=3, seed=2))
        for hidden in (spring, both)
    }
    named, beside = (diagnose([first], iiwa14, heldout=[second]) for first, second in recordings.values())
    assert [(item.effect, item.place.joint) for item in named.findings] == [("cable_spring", 3)]
    assert [(item.name, item.joint, item.named) for item in named.classes] == [("own_position", 3, True)]
    assert named.verdict == "explained"
    assert {item.joint for item in beside.classes if item.named} == {3}
    assert {item.joint for item in beside.unnamed} == {5}
    assert beside.verdict == "partly_explained"


def test_a_class_lowers_the_error_of_a_motion_that_was_not_fitted(humped: Diagnosis) -> None:
    model = humped.class_model
    assert model is not None
    assert model.heldout_after_nm[2] < 0.7 * model.heldout_before_nm[2]
    assert humped.classes[0].heldout_gain_nm[2] > 0.0
    others = [0, 1, 3, 4, 5, 6]
    assert np.all(model.heldout_after_nm[others] < 1.05 * model.heldout_before_nm[others])


def test_the_curve_of_a_class_is_the_torque_within_its_band(humped: Diagnosis) -> None:
    curve = humped.classes[0].curve
    assert curve is not None
    truth = 0.3 / (1.0 + ((curve.place - 0.1) / 0.3) ** 4)
    # What base parameters may take up is open: a constant and gravity's first harmonic.
    open_to_base = np.stack([np.ones_like(truth), np.sin(curve.place), np.cos(curve.place)], axis=1)
    missed = truth - curve.mean_nm
    left = missed - open_to_base @ np.linalg.lstsq(open_to_base, missed, rcond=None)[0]
    assert np.std(left) < 0.25 * np.std(truth)
    assert np.mean(np.abs(left) < 3.0 * curve.std_nm) > 0.9


def test_the_contract_s_fields_are_there(humped: Diagnosis) -> None:
    data = json.loads(json.dumps(humped.to_json(), allow_nan=False))
    assert {
        "class", "joint", "rms_nm", "ci95_nm", "significance", "heldout_gain_nm", "alternatives", "nearest_forms",
        "sentence", "named",
    } <= set(data["classes"][0])  # fmt: skip
    assert len(data["classes"][0]["heldout_gain_nm"]) == 7


def test_the_page_says_the_class_and_draws_its_curve_with_a_band(humped: Diagnosis) -> None:
    section = class_section(humped)
    assert section is not None
    figures = [block for block in section.blocks if block.block == "figure"]
    assert figures[0].panels[0].lines[0].band is not None
    assert section.blocks[-1].caption.endswith(", Nm")  # at the end, where "(N of prismatic joints)" is put


def test_a_strong_class_of_one_joint_leaves_nothing_to_be_said_of_another(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """It bends the base parameters, so that without its class other joints are left more than noise, too."""

    def sensor_bends(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        del q, dq
        return on_joint(4, 4.0 * (torque[:, 3] / np.abs(torque[:, 3]).max()) ** 3)

    fitted, unseen = (
        record(iiwa14, table3, sensor_bends, motion=12),
        record(iiwa14, table3, sensor_bends, periods=4, seed=2),
    )
    found = diagnose([fitted], iiwa14, heldout=[unseen])
    assert found.classes[0].name == "own_load"
    assert {item.joint for item in found.classes} == {4}


def test_what_only_the_held_out_recording_shows_is_no_class_of_the_arm(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """It was: "a torque that follows its own acceleration, 0.00001 Nm (0 to 0.00027)", at 39 nats."""

    def nothing(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return np.zeros_like(hump(q, dq, torque))

    fitted = record(iiwa14, table3, nothing, motion=9)
    unseen = record(iiwa14, table3, hump, periods=4, motion=3, seed=2)
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    assert diagnosis.classes == ()
    assert "Something differs between the fitted recordings" in diagnosis.remaining


def test_of_noise_nothing_is_said(clean_diagnosis: Diagnosis) -> None:
    assert clean_diagnosis.classes == ()
    assert class_section(clean_diagnosis) is None


def smooth_error(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """On every joint a smooth function of its position and speed and of the next one's position, with no form."""
    random = np.random.default_rng(8)
    following = np.roll(q, -1, axis=1)
    for joint in range(7):
        state = np.stack([q[:, joint], dq[:, joint], following[:, joint]], axis=1)
        waves = np.cos(state @ random.normal(size=(3, 12)) + random.uniform(0.0, 6.28, 12))
        torque = torque + on_joint(joint + 1, 0.03 * waves @ random.normal(size=12))
    return torque


def test_beside_a_smooth_error_of_every_joint_no_class_and_no_name_is_said(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    def hidden(q: np.ndarray, dq: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return smooth_error(q, dq, np.zeros_like(torque))

    fitted = record(iiwa14, table3, hidden, motion=9)
    unseen = record(iiwa14, table3, hidden, periods=4, motion=3, seed=2)
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    assert diagnosis.classes == ()
    assert diagnosis.findings == ()
    assert diagnosis.verdict == "unexplained"
    assert any("smooth function of the state" in note for note in diagnosis.notes)


@pytest.fixture(scope="module")
def emps() -> Diagnosis:
    return diagnose([read_recording(recording_file("emps_a.npz"))], load_robot(recording_file("emps.urdf")))


def test_the_worn_screw_of_the_emps_is_a_torque_that_depends_on_velocity(emps: Diagnosis) -> None:
    """Janot, Gautier and Brunot: viscous friction 166.71 one way, 240.42 N s/m the other; half difference −36.86.

    That is even in velocity, which no base column is: the even part of the curve has that slope.
    """
    (claim,) = (item for item in emps.classes if item.name == "own_velocity")
    assert claim.curve is not None
    speed, even = claim.curve.place, 0.5 * (claim.curve.mean_nm + claim.curve.mean_nm[::-1])
    fast = speed > 0.2 * speed.max()
    assert np.polyfit(speed[fast], even[fast], 1)[0] == pytest.approx(-36.86, rel=0.15)
    model = emps.class_model
    assert model is not None
    assert model.heldout_after_nm[0] < 0.5 * model.heldout_before_nm[0]
    # The axis slides; and no class alone can bring more than all classes together bring.
    assert "force" in claim.sentence
    assert "N RMS" in claim.sentence
    assert "Nm" not in claim.sentence
    for item in emps.classes:
        assert item.heldout_gain_nm[0] <= model.heldout_before_nm[0] - model.heldout_after_nm[0] + 1e-12


def test_torque_without_a_name_is_part_of_the_model_that_validate_reads(
    humped: Diagnosis, iiwa14: RobotModel, table3: PhysicalParameters, tmp_path: Path
) -> None:
    fitted = record(iiwa14, table3, hump, motion=9)
    another = record(iiwa14, table3, hump, periods=4, motion=3, seed=5)
    data = extended_model(replace(humped, findings=()), [fitted], iiwa14)
    assert ("own_position", 3) in {(term["class"], term["joint"]) for term in data["class_terms"]["terms"]}
    write_model(data, tmp_path / "with.json")
    write_model({name: value for name, value in data.items() if name != "class_terms"}, tmp_path / "without.json")
    with_terms, without = (
        validate_with_effects(read_model(tmp_path / name), [another]).rows[0].rms_nm
        for name in ("with.json", "without.json")
    )
    assert with_terms[2] < 0.3 * without[2]
    noise = NOISE_NM / np.sqrt(4.0)
    assert with_terms == pytest.approx(np.full(7, noise), rel=0.2)
    # The figure that stands with the model is of the same rows: the noise of all frequencies.
    own = validate_with_effects(read_model(tmp_path / "with.json"), [fitted]).rows[0]
    assert data["rms_nm"]["fit"] == pytest.approx(own.rms_nm, rel=1e-9)
    assert own.rms_nm == pytest.approx(own.noise_floor_nm, rel=0.2)


def test_terms_of_another_arm_are_refused(humped: Diagnosis, clean_evidence: Evidence) -> None:
    assert humped.offer is not None
    torn = {**humped.offer.terms, "terms": [{"class": "own_position"}]}
    with pytest.raises(ModelFileError, match="class terms"):
        terms_torque(torn, clean_evidence.motion)


def test_terms_of_a_version_that_kept_no_bending_moments_are_refused_in_words(
    humped: Diagnosis, clean_evidence: Evidence
) -> None:
    """Each motion scaled them by its own: the same term was another torque on another motion."""
    assert humped.offer is not None
    ranges = {name: item for name, item in humped.offer.terms["ranges"].items() if name != "bending"}
    with pytest.raises(ModelFileError, match="diagnose the recording again"):
        terms_torque({**humped.offer.terms, "ranges": ranges}, clean_evidence.motion)


def test_terms_are_the_same_torque_with_vectors_of_the_other_sign_and_other_random_numbers(
    humped: Diagnosis, clean_evidence: Evidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Weights met the vectors as a library gave them: of the other sign, as LAPACK's ?syevr has them, a term turned."""
    assert humped.offer is not None
    expected = terms_torque(humped.offer.terms, clean_evidence.motion)
    assert np.abs(expected).max() > 0.1

    def turned(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        values, vectors = eigh(matrix)
        return values, -vectors

    monkeypatch.setattr(np.linalg, "eigh", turned)
    monkeypatch.setattr(np.random, "default_rng", lambda seed: np.random.Generator(np.random.MT19937(seed)))
    smooth_table.cache_clear()
    np.testing.assert_allclose(terms_torque(humped.offer.terms, clean_evidence.motion), expected, atol=1e-6)
    smooth_table.cache_clear()
    older = {name: item for name, item in humped.offer.terms.items() if name != "waves"}
    with pytest.raises(ModelFileError, match="diagnose the recording again"):
        terms_torque(older, clean_evidence.motion)


def test_what_is_refused_for_the_model_is_said_all_the_same(emps: Diagnosis, monkeypatch: pytest.MonkeyPatch) -> None:
    """Terms are refused against a fit with other weights; one of a joint took every class of every joint with it."""
    first, axis = read_recording(recording_file("emps_a.npz")), load_robot(recording_file("emps.urdf"))

    def nothing(
        alone: Selection, left: Left, before: Residuals, weight: np.ndarray
    ) -> tuple[None, tuple[Dropped, ...]]:
        del left, before, weight
        places = ((joint, number) for joint, state in enumerate(alone.states) for number in alone.classes(joint, state))
        return None, tuple(places)

    monkeypatch.setattr(judgement, "offer", nothing)
    refused = diagnose([first], axis)
    assert emps.offer is not None
    assert refused.offer is None
    assert any("not part of the extended model" in note for note in refused.notes)
    assert emps.classes
    assert [(item.name, item.joint) for item in refused.classes] == [(item.name, item.joint) for item in emps.classes]


@pytest.mark.parametrize("weights", [1, 3, 8])
def test_the_interval_of_a_size_holds_it_19_times_in_20(weights: int) -> None:
    """Truth: weights drawn from a Gaussian about known ones. Once the ends of the mean square's interval were taken."""
    random = np.random.default_rng(weights)
    true, sigma, draws = random.normal(size=weights), 0.1, 4000
    true *= 8.0 * sigma / np.linalg.norm(true)
    held = 0
    for drawn in true + sigma * random.normal(size=(draws, weights)):
        square = float(drawn @ drawn)
        deviation = np.sqrt(4.0 * square * sigma**2 + 2.0 * weights * sigma**4)
        low, high = rms_interval(square, float(deviation))[1]
        held += low <= np.linalg.norm(true) <= high
    assert 0.92 < held / draws < 0.975


def test_a_size_of_three_deviations_is_not_nothing_and_one_of_one_may_be() -> None:
    sigma = 0.1
    for size, least in ((3.0 * sigma, 0.9 * sigma), (sigma, 0.0)):
        (low, high) = rms_interval(size**2, float(np.sqrt(4.0 * size**2 * sigma**2 + 2.0 * sigma**4)))[1]
        assert low == pytest.approx(least, abs=0.2 * sigma)
        assert high > size


def test_a_model_that_makes_a_joint_worse_elsewhere_is_not_offered(
    iiwa14: RobotModel, table3: PhysicalParameters
) -> None:
    """The held-out arm has no hump: what was learned is wrong there."""
    fitted = record(iiwa14, table3, hump, motion=9)
    unseen = record(iiwa14, table3, periods=4, motion=3, seed=2)
    diagnosis = diagnose([fitted], iiwa14, heldout=[unseen])
    assert diagnosis.offer is None
    (note,) = (note for note in diagnosis.notes if "not part of the extended model" in note)
    assert "joint 3: " in note


@pytest.mark.parametrize("chooses", [0, 1])
def test_the_model_of_the_emps_holds_on_the_half_of_a_run_that_chose_nothing(tmp_path: Path, chooses: int) -> None:
    """Recording b leaves the range of a; with terms that describe every row of a its error was 5.2 N, not 2.2 N."""
    axis, whole = load_robot(recording_file("emps.urdf")), dict(np.load(recording_file("emps_b.npz")))
    size = len(whole["t"])
    for half in (0, 1):
        rows = slice(half * size // 2, (half + 1) * size // 2)
        kept = {name: item[rows] if item.ndim and len(item) == size else item for name, item in whole.items()}
        np.savez(tmp_path / f"half{half}.npz", **kept)
    first, choosing, other = (
        read_recording(path)
        for path in (
            recording_file("emps_a.npz"), tmp_path / f"half{chooses}.npz", tmp_path / f"half{1 - chooses}.npz",
        )
    )  # fmt: skip
    diagnosis = diagnose([first], axis, heldout=[choosing])
    model = read_model(write_model(extended_model(diagnosis, [first], axis), tmp_path / "extended.json"))
    plain = validate_model(fit_recordings([first], axis), [other]).rows[0].rms_nm[0]
    assert validate_with_effects(model, [other]).rows[0].rms_nm[0] < 0.65 * plain
