"""Claims about a load on the last joint's axis, which does to the torque what it does on the link before.

Truth: Pinocchio's torque of the paper's arm with a point mass at the flange, added by the parallel-axis theorem.
"""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
import pytest

from fixtures.physics import iiwa14_table_three
from identification.audit import audit
from identification.audit.basis import Explanation
from identification.audit.hypotheses import Hypothesis
from identification.audit.search import Scored, _alike
from identification.model_file import Model, read_model, write_model
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import Recording, read_recording
from identification.robots import load_robot
from tests.identification.synthetic import fourier_motion, inverse_dynamics

NOISE_NM = 0.05


def recorded(folder: Path, seed: int, mass: float = 0.0, height: float = 0.0) -> Recording:
    """mass: kg on the axis of joint 7, height m from the origin of link 7."""
    links, samples = iiwa14_table_three(), 2000
    masses, centres, inertias = links.mass.copy(), links.center_of_mass.copy(), links.inertia.copy()
    place, total = np.array([0.0, 0.0, height]), masses[6] + mass
    arm = place - centres[6]
    inertias[6] = inertias[6] + masses[6] * mass / total * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    centres[6] = (masses[6] * centres[6] + mass * place) / total
    masses[6] = total
    physical = PhysicalParameters(masses, centres, inertias, links.viscous, links.coulomb)
    states = fourier_motion(7, period_s=20.0, samples=samples, seed=seed)
    torque = inverse_dynamics(load_robot("iiwa14"), physical, *states)
    torque += NOISE_NM * np.random.default_rng(100 + seed).standard_normal((samples, 7))
    file = folder / f"{seed}-{mass}.npz"
    np.savez(file, t=np.arange(samples) * 0.01, q=states[0], tau=torque, robot="iiwa14")
    return read_recording(file)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    folder = tmp_path_factory.mktemp("model")
    result = fit_recordings([recorded(folder, 31)], load_robot("iiwa14"), FitSettings(physical=False))
    return read_model(write_model(result.to_model_json(notes=False), folder / "model.json"))


@pytest.mark.parametrize(("seed", "mass", "height"), [(32, 3.0, 0.15), (33, 1.0, 0.1), (34, 2.0, 0.2), (35, 0.5, 0.15)])
def test_a_load_on_the_last_axis_is_at_the_flange_with_the_link_before_named_beside_it(
    model: Model, tmp_path: Path, seed: int, mass: float, height: float
) -> None:
    found = audit([recorded(tmp_path, seed, mass, height)], load_robot("iiwa14"), model)
    load = found.differences[0]
    assert load.effect == "payload"
    assert load.link == 7
    low, high = load.numbers[0].interval
    assert low < mass < high
    assert "a load on link 6" in load.sentence
    assert found.holds


def scored(effect: str, link: int, nats: float) -> Scored:
    return Scored(nats, 1.0, Hypothesis(effect, np.arange(4), np.ones(4), 0.0, link=link), cast(Explanation, None))


def test_a_body_that_is_as_likely_comes_with_a_load_on_its_link_whatever_link_was_chosen() -> None:
    """A load on a link was left out beside another body of it, but for the link that was chosen."""
    chosen, near, far = scored("payload", 6, 1000.0), scored("link_parameters", 5, 999.0), scored("payload", 5, 700.0)
    elsewhere = scored("payload", 3, 700.0)
    others = _alike(chosen, [chosen, near, far, elsewhere])
    assert [(other.effect, other.link) for other in others] == [("link_parameters", 5), ("payload", 5)]


def test_a_load_that_is_as_likely_as_one_on_the_chosen_link_is_named_with_it() -> None:
    """0.65 kg in the middle of the flange, beside a drawn file: another body of link 6, or a load on it, was said."""
    chosen, on_it = scored("link_parameters", 5, 121.0), scored("payload", 5, 100.9)
    flange, elsewhere = scored("payload", 6, 99.2), scored("payload", 3, 80.0)
    others = _alike(chosen, [chosen, on_it, flange, elsewhere])
    assert [(other.effect, other.link) for other in others] == [("payload", 5), ("payload", 6)]
