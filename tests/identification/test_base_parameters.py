"""Base parameters. Truth: eq. (6) of the paper, typed in here by hand; Table 2's names; ranks of random regressors."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.base_parameters import BaseRegressor, RegressorOptions, independent_columns
from identification.physical_parameters import PhysicalParameters
from identification.regressor import torque_regressor
from identification.robots import RobotModel, load_robot, robot_from_arrays, robot_from_urdf

# Eq. (6), with XX_5 for the misprinted XZ_5 in XXR_5. {rl3}, {rl5}: lengths.
EQUATION_6 = """
ZZR_1 = ZZ_1 + YY_2
MYR_2 = MY_2 + MZ_3 + rl3 MR_3
XXR_2 = XX_2 - YY_2 + YY_3 + 2rl3 MZ_3 + rl3^2 MR_3
ZZR_2 = ZZ_2 + YY_3 + 2rl3 MZ_3 + rl3^2 MR_3
MR_3 = M_3 + MR_4
XXR_3 = XX_3 - YY_3 + YY_4
MYR_3 = MY_3 + MZ_4
ZZR_3 = ZZ_3 + YY_4
MR_4 = M_4 + MR_5
MYR_4 = MY_4 - MZ_5 - rl5 MR_5
XXR_4 = XX_4 + YY_5 - YY_4 + 2rl5 MZ_5 + rl5^2 MR_5
ZZR_4 = ZZ_4 + YY_5 + 2rl5 MZ_5 + rl5^2 MR_5
MR_5 = M_5 + MR_6
MYR_6 = MY_6 + MZ_7
MYR_5 = MY_5 - MZ_6
XXR_6 = XX_6 - YY_6 + YY_7
XXR_5 = XX_5 - YY_5 + YY_6
MR_6 = M_6 + M_7
ZZR_5 = ZZ_5 + YY_6
ZZR_6 = ZZ_6 + YY_7
XXR_7 = XX_7 - YY_7
"""


def equation_6(full_names: tuple[str, ...], rl3: float, rl5: float) -> dict[str, np.ndarray]:
    """Rows of K by the name of the base parameter, from the text above."""
    factors = {"": 1.0, "rl3": rl3, "2rl3": 2 * rl3, "rl3^2": rl3**2, "rl5": rl5, "2rl5": 2 * rl5, "rl5^2": rl5**2}
    definitions = dict(line.split(" = ") for line in EQUATION_6.strip().splitlines())

    def row(name: str) -> np.ndarray:
        if name not in definitions:
            return np.eye(len(full_names))[full_names.index(name)]
        total = np.zeros(len(full_names))
        for sign, factor, term in re.findall(r"([+-]?) ?(2?rl\d(?:\^2)?)? ?([A-Z]+_\d)", definitions[name]):
            total += (-1.0 if sign == "-" else 1.0) * factors[factor] * row(term)
        return total

    return {name: row(name) for name in definitions}


@pytest.mark.parametrize(("name", "rl3", "rl5"), [("iiwa14", 0.42, 0.40), ("iiwa7", 0.40, 0.40)])
def test_regrouping_equals_equation_6(name: str, rl3: float, rl5: float) -> None:
    base = BaseRegressor(load_robot(name))
    expected = equation_6(base.full_names, rl3, rl5)
    for parameter, row in zip(base.names, base.regrouping, strict=True):
        plain = parameter.replace("ZZR_7", "ZZ_7")
        truth = expected.get(
            plain, np.eye(len(base.full_names))[base.full_names.index(plain)] if plain in base.full_names else None
        )
        assert truth is not None, parameter
        np.testing.assert_allclose(row, truth, rtol=0.0, atol=64 * np.finfo(np.float64).eps, err_msg=parameter)


def test_the_iiwa_14_has_table_2s_57_parameters_in_its_order(
    iiwa14_base: BaseRegressor, table2: dict[str, float]
) -> None:
    assert iiwa14_base.names == tuple(table2)
    assert iiwa14_base.size == 57


def test_rank_of_the_base_columns_is_that_of_all_columns(iiwa14: RobotModel) -> None:
    """Truth: singular values of Pinocchio-verified columns; 43 inertial parameters."""
    generator = np.random.default_rng(9)
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (100, 7)) for _ in range(3))
    singular = np.linalg.svd(torque_regressor(iiwa14, q, dq, ddq).reshape(700, 70), compute_uv=False)
    rank = int(np.sum(singular > 1e-9 * singular[0]))
    assert rank == 43 == BaseRegressor(iiwa14, RegressorOptions(viscous=False, coulomb=False)).size


def test_a_column_of_rounding_noise_is_dropped_before_normalising() -> None:
    """The trap of MZ_2: 1e-16 noise, which normalised would look like a 44th independent column."""
    generator = np.random.default_rng(10)
    columns = generator.normal(size=(50, 3))
    columns[:, 1] *= 1e-16
    assert independent_columns(columns, np.arange(3)).tolist() == [0, 2]


def test_base_torque_equals_full_torque(
    iiwa14: RobotModel, iiwa14_base: BaseRegressor, table3: PhysicalParameters
) -> None:
    generator = np.random.default_rng(11)
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (50, 7)) for _ in range(3))
    inertial = torque_regressor(iiwa14, q, dq, ddq) @ table3.dynamic_parameters().ravel()
    friction = dq * table3.viscous + np.sign(dq) * table3.coulomb
    values = iiwa14_base.base_from_physical(table3)
    for torque in (iiwa14_base.matrix(q, dq, ddq) @ values, iiwa14_base.torque(values, q, dq, ddq)):
        np.testing.assert_allclose(torque, inertial + friction, atol=1e-12)


def test_stacked_matrix_is_the_same_joint_by_joint(iiwa14_base: BaseRegressor) -> None:
    generator = np.random.default_rng(12)
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (1203, 7)) for _ in range(3))
    matrix = iiwa14_base.matrix(q, dq, ddq)
    stacked, joint = iiwa14_base.stacked(q, dq, ddq)
    for index in range(7):
        np.testing.assert_array_equal(stacked[joint == index], matrix[:, index])


def test_packed_columns_of_each_joint_are_those_of_the_matrix_and_leave_out_only_zeros(iiwa14: RobotModel) -> None:
    base = BaseRegressor(iiwa14, RegressorOptions(rotor_inertia=True, offset=True))
    generator = np.random.default_rng(13)
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (4101, 7)) for _ in range(3))
    matrix = base.matrix(q, dq, ddq)
    for joint, (packed, positions) in enumerate(base.joint_columns(q, dq, ddq)):
        rebuilt = np.zeros((len(q), base.size))
        rebuilt[:, positions] = packed.T
        np.testing.assert_array_equal(rebuilt, matrix[:, joint])


def test_rotor_inertia_of_joint_1_is_grouped_into_its_link_and_the_others_named(iiwa14: RobotModel) -> None:
    base = BaseRegressor(iiwa14, RegressorOptions(rotor_inertia=True, offset=True))
    assert "IA_1" not in base.names
    assert "IA_2" not in base.names
    assert [name for name in base.names if name.startswith("IA")] == [f"IA_{joint}" for joint in range(3, 8)]
    assert base.regrouping[base.position_of("ZZR_1"), base.full_names.index("IA_1")] == pytest.approx(1.0)
    assert [name for name in base.names if name.startswith("OFF")] == [f"OFF_{joint}" for joint in range(1, 8)]
    assert base.units[base.position_of("IA_4")] == "kg m^2"
    assert base.units[base.position_of("OFF_4")] == "Nm"


def test_positions_accept_names_with_and_without_the_mark(iiwa14_base: BaseRegressor) -> None:
    assert iiwa14_base.position_of("ZZ_7") == iiwa14_base.position_of("ZZR_7") == 54
    with pytest.raises(KeyError, match="MZ_2"):
        iiwa14_base.position_of("MZ_2")


def test_options_without_friction_leave_its_columns_out(iiwa14: RobotModel) -> None:
    base = BaseRegressor(iiwa14, RegressorOptions(viscous=True, coulomb=False))
    assert base.size == 50
    velocity = np.arange(14.0).reshape(2, 7) - 6.5
    columns = base.matrix(np.zeros((2, 7)), velocity, np.zeros((2, 7)))
    viscous = [base.position_of(f"FV_{joint}") for joint in range(1, 8)]
    np.testing.assert_array_equal(columns[:, :, viscous], velocity[:, :, None] * np.eye(7))


def test_a_pendulum_has_its_three_textbook_parameters() -> None:
    base = BaseRegressor(robot_from_arrays(np.array([[np.pi / 2, 0.0, 0.0, 0.0]])))
    assert base.names == ("MX_1", "MY_1", "ZZ_1", "FV_1", "FS_1")


def test_a_wheel_about_the_vertical_has_inertia_only() -> None:
    base = BaseRegressor(robot_from_arrays(np.array([[0.0, 0.0, 0.0, 0.0]])), RegressorOptions(False, False))
    assert base.names == ("ZZ_1",)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_any_chains_torque_is_preserved_by_the_grouping(n: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    parameters = generator.uniform(-1.5, 1.5, (n, 4)).round(1)
    robot = robot_from_arrays(parameters, revolute=generator.random(n) < 0.6)
    base = BaseRegressor(robot, RegressorOptions(rotor_inertia=True, offset=True))
    q, dq, ddq = (generator.uniform(-2.0, 2.0, (10, n)) for _ in range(3))
    full = generator.normal(size=(n, 14))
    torque = torque_regressor(robot, q, dq, ddq) @ full[:, :10].ravel()
    torque += dq * full[:, 10] + np.sign(dq) * full[:, 11] + ddq * full[:, 12] + full[:, 13]
    rebuilt = base.matrix(q, dq, ddq) @ base.base_from_full(full.ravel())
    np.testing.assert_allclose(rebuilt, torque, atol=1e-9 * max(1.0, np.abs(torque).max()))


BRANCHES = """<robot name="branches"><link name="base"/><link name="upper"/><link name="hand"/><link name="left"/>
<link name="right"/>
<joint name="a" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
<joint name="b" type="continuous"><parent link="upper"/><child link="hand"/><origin xyz="0.1 0 0.2"/><axis xyz="0 1 0"/>
</joint>
<joint name="c" type="prismatic"><parent link="hand"/><child link="left"/><origin xyz="0.1 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="9"/></joint>
<joint name="d" type="continuous"><parent link="hand"/><child link="right"/><origin xyz="0.1 0 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" velocity="1" effort="9"/></joint></robot>"""


def test_a_joint_of_one_branch_feels_nothing_of_a_link_on_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the fit reads against the whole matrix; memory that nobody has written to is marked."""
    base = BaseRegressor(robot_from_urdf(BRANCHES, source="branches.urdf"))
    states = np.random.default_rng(5).normal(size=(3, 20, 4))
    whole = base.matrix(*states)
    monkeypatch.setattr(np, "empty", lambda shape, dtype=np.float64, order="C": np.full(shape, np.nan, dtype, order))
    columns = base.joint_columns(*states)
    monkeypatch.undo()
    rebuilt = np.zeros_like(whole)
    for joint, (packed, positions) in enumerate(columns):
        rebuilt[:, joint, positions] = packed.T
    np.testing.assert_allclose(rebuilt, whole, atol=1e-12)
