"""What may be different between a model and an arm: each hypothesis as columns, their widths, and its prior odds.

The columns of a comparison stand in one order: fourteen parameters of each link, then the scale of each torque sensor,
of all of them, two tangents of gravity, the clock, the delay, and the zero of each joint. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from identification.arrays import BoolArray, FloatArray, IntArray
from identification.audit.columns import INERTIAL, PARAMETERS, SYMBOLS
from identification.audit.given import GivenModel, Sizes

ODDS = {
    "payload": 0.15,
    "payload_elsewhere": 0.05,
    "link_parameters": 0.01,
    "drawn_link_parameters": 0.4,
    "friction_change": 0.3,
    "torque_offset": 0.1,
    "torque_sensor_gain": 0.1,
    "common_gain": 0.1,
    "rotor_inertia": 0.05,
    "rotor_inertias": 0.4,
    "joint_zero_offset": 0.05,
    "base_tilt": 0.1,
    "torque_delay": 0.05,
    "wrong_time_base": 0.05,
}
"""Prior probability of each kind; one of a kind that every joint may have is shared by the joints. A link of the arm
that a model was fitted to is another only where it was repaired; what hangs on it changes far more often.
"""
GAIN_WIDTH, DELAY_WIDTH_S, ZERO_WIDTH_RAD, CLOCK_WIDTH = 1.0, 0.02, 0.1, 0.2
TILT_WIDTH_RAD = 1.0
LOAD_SHARE = 0.5
"""A load may make half of the torque."""
LOAD_SIZES = 2.0
"""A load's mass in sizes of the arm's mean link."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Where the columns of n joints stand."""

    n: int

    def parameter(self, link: int, symbol: str) -> int:
        """Of one parameter of a link (from 0)."""
        return link * PARAMETERS + SYMBOLS.index(symbol)

    @property
    def base(self) -> IntArray:
        """(14 n,) the parameters."""
        return np.arange(PARAMETERS * self.n)

    @property
    def gain(self) -> int:
        """The first of n scales; after them that of all."""
        return PARAMETERS * self.n

    @property
    def tilt(self) -> int:
        """The first of two tangents of gravity."""
        return self.gain + self.n + 1

    @property
    def clock(self) -> int:
        """The logarithm of the clock's ratio."""
        return self.tilt + 2

    @property
    def delay(self) -> int:
        """The common delay."""
        return self.tilt + 3

    @property
    def zero(self) -> int:
        """The first of n zeros."""
        return self.tilt + 4

    @property
    def width(self) -> int:
        """Number of columns."""
        return self.zero + self.n


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One thing that may be different. effect: its name (contract §7). joint, link: from 0. columns: (m,) places;
    width: (m,) of the prior. log_odds: of the prior. bends: whether its torque is not linear in its numbers.
    """

    effect: str
    columns: IntArray
    width: FloatArray
    log_odds: float
    joint: int | None = None
    link: int | None = None
    bends: bool = False

    @property
    def place(self) -> tuple[str, int | None, int | None]:
        """What tells it from the others."""
        return self.effect, self.joint, self.link

    @property
    def is_body(self) -> bool:
        """Whether it is mass on a link."""
        return self.link is not None


def hypotheses(
    layout: Layout, sizes: Sizes, rms: FloatArray, model: GivenModel, revolute: BoolArray, *, clock_known: bool
) -> list[Hypothesis]:
    """Every hypothesis. rms: (K,) of each column over all joints; columns that are zero have no hypothesis.

    But for gravity: its two tangents turn with it, so one without torque here has some where the base stands otherwise.

    In a fit of this arm a link does not change but what hangs on it does. A file without rotor inertias lacks those of
    all joints, where the torque is measured on the motors' side. A clock that a recorded velocity has right is not
    asked.
    """
    n = layout.n
    result: list[Hypothesis] = []

    def add(effect: str, odds: float, columns: list[int], width: list[float] | FloatArray, **place: object) -> None:
        chosen = np.array(columns, dtype=np.int64)
        live = rms[chosen] > 1e-9
        if live.any():
            live |= effect == "base_tilt"
            widths = np.asarray(width, dtype=np.float64)
            result.append(Hypothesis(effect, chosen[live], widths[live], float(np.log(odds)), **place))  # type: ignore[arg-type]

    torque = float(np.sqrt(np.sum(sizes.torque**2)))
    for link in range(n):
        inertial = [layout.parameter(link, symbol) for symbol in SYMBOLS[:INERTIAL]]
        mass = float(sizes.mass.mean()) * LOAD_SIZES
        if rms[inertial[0]] > 0.0:
            mass = min(mass, LOAD_SHARE * torque / rms[inertial[0]])
        length = float(sizes.length.max())
        width = mass * np.array([1.0, *3 * [length], *6 * [length**2]])
        odds = ODDS["payload"] if link == n - 1 else ODDS["payload_elsewhere"] / n
        add("payload", odds, inertial[:4], width[:4], link=link)
        add("payload", 0.5 * odds, inertial, width, link=link)
        odds = ODDS["link_parameters" if model.own else "drawn_link_parameters"] / n
        add("link_parameters", odds, inertial, sizes.each[inertial], link=link)
    for joint in range(n):
        viscous, coulomb, offset, rotor = (layout.parameter(joint, symbol) for symbol in SYMBOLS[INERTIAL:])
        friction = [viscous, coulomb, offset]
        # One odds for a change of friction; half of it for each form that needs a single number.
        for chosen, share in ((friction, 1.0), ([viscous], 0.5), ([coulomb], 0.5)):
            add("friction_change", share * ODDS["friction_change"] / n, chosen, sizes.each[chosen], joint=joint)
        add("torque_offset", ODDS["torque_offset"] / n, [offset], sizes.each[[offset]], joint=joint)
        add("rotor_inertia", ODDS["rotor_inertia"] / n, [rotor], sizes.each[[rotor]], joint=joint)
        add("torque_sensor_gain", ODDS["torque_sensor_gain"] / n, [layout.gain + joint], [GAIN_WIDTH], joint=joint)
        if revolute[joint]:
            add(
                "joint_zero_offset", ODDS["joint_zero_offset"] / n, [layout.zero + joint], [ZERO_WIDTH_RAD],
                joint=joint, bends=True,
            )  # fmt: skip
    if not model.rotors:
        every = [layout.parameter(joint, "IA") for joint in range(n)]
        add("rotor_inertia", ODDS["rotor_inertias"], every, sizes.each[every])
    add("torque_sensor_gain", ODDS["common_gain"], [layout.gain + n], [GAIN_WIDTH])
    add("base_tilt", ODDS["base_tilt"], [layout.tilt, layout.tilt + 1], 2 * [TILT_WIDTH_RAD], bends=True)
    add("torque_delay", ODDS["torque_delay"], [layout.delay], [DELAY_WIDTH_S], bends=True)
    if not clock_known:
        add("wrong_time_base", ODDS["wrong_time_base"], [layout.clock], [CLOCK_WIDTH], bends=True)
    return result
