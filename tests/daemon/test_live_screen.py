"""Claims about what the live view makes of its frames: motion, modelled torque, bars and the screen.

Truth: closed forms of sinusoids, and noise whose size the test chose.
"""

from __future__ import annotations

import io
import itertools
import re
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from daemon.live.residual import LiveResidual, PeriodNoise, noise_sentence
from daemon.live.screen import Screen, bar, drawn, remaining_s
from daemon.live.watcher import Watcher
from daemon.motion.torque_foresight import torque_foresight
from safety.limits import limits_for
from tests.daemon.live_frames import frame, sinusoid


def test_velocity_and_acceleration_are_those_of_the_closed_form() -> None:
    amplitude, frequency = 0.5, 0.5
    w = 2.0 * np.pi * frequency
    for each in LiveResidual(None).take(sinusoid(amplitude, frequency, 100)):
        t = each.frame.robot_time_s
        # Central differences err by h²/6 of the third and h²/12 of the fourth derivative.
        np.testing.assert_allclose(each.velocity, amplitude * w * np.cos(w * t), atol=amplitude * w**3 * 1e-4 / 6 * 1.1)
        np.testing.assert_allclose(
            each.acceleration, -amplitude * w**2 * np.sin(w * t), atol=amplitude * w**4 * 1e-4 / 12 * 1.1 + 1e-9
        )


def test_no_acceleration_is_taken_over_a_gap() -> None:
    frames = sinusoid(0.5, 0.5, 40)
    known = LiveResidual(None).take(frames[:10] + frames[30:])
    assert {round(each.frame.robot_time_s, 3) for each in known} == {
        round(0.01 * place, 3) for place in [*range(1, 9), *range(31, 39)]
    }


def test_at_rest_the_modelled_torque_is_gravity() -> None:
    foresight = torque_foresight("iiwa14")
    assert foresight is not None
    rest = (0.1, 0.4, -0.1, -1.2, 0.1, 0.9, 0.1)
    still = [frame(robot_time_s=0.01 * place, position=rest) for place in range(3)]
    (known,) = LiveResidual(foresight).take(still)
    row = foresight.regressor.matrix(np.array([rest]), np.zeros((1, 7)), np.zeros((1, 7))) @ foresight.values
    np.testing.assert_allclose(known.modelled, row[0], atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1.0, 3.0])
def test_the_ratio_to_the_noise_is_what_was_put_in(size: float) -> None:
    """An error of the model of `size` times the noise: the RMS of both together is sqrt(1 + size²) times the noise."""
    generator = np.random.default_rng(77)
    places, sigma = 4000, np.array([0.17, 0.17, 0.12, 0.12, 0.08, 0.04, 0.03])
    truth = 10.0 * np.sin(np.arange(places) / 200.0)
    noise = PeriodNoise(places)
    for period, place in itertools.product(range(3), range(places)):
        each = sigma * generator.standard_normal(7)
        noise.take(period, place, truth[place] + each, size * sigma + each)
        if period == 0:
            assert noise.ratio is None
    ratio = noise.ratio
    assert ratio is not None
    np.testing.assert_allclose(ratio, np.sqrt(1.0 + size**2), rtol=0.06)  # 4000 places: 5 σ of an RMS are 5.6 %


def test_what_a_late_message_did_to_the_torque_counts_neither_as_noise_nor_as_misfit() -> None:
    """A frame with 50 Nm too much right after each late message; all others are the model's own torque and 0.1 Nm."""
    foresight = torque_foresight("iiwa14")
    assert foresight is not None
    generator = np.random.default_rng(4)
    rest = (0.1, 0.4, -0.1, -1.2, 0.1, 0.9, 0.1)
    own = (foresight.regressor.matrix(np.array([rest]), np.zeros((1, 7)), np.zeros((1, 7))) @ foresight.values)[0]
    frames = []
    for number in range(300):
        late = 1 + number // 90
        shove = 50.0 * (number % 90 < 5)
        torque = tuple((own + shove + 0.1 * generator.standard_normal(7)).tolist())
        frames.append(
            frame(robot_time_s=0.01 * number, position=rest, torque=torque, late=late, period=number // 100,
                  sample_in_period=10 * (number % 100))
        )  # fmt: skip
    residual = LiveResidual(foresight)
    residual.take(frames)
    assert residual.ratio is not None
    assert np.all(residual.ratio < 1.5)


def test_the_sentence_names_the_joint_that_the_model_fits_worst() -> None:
    assert noise_sentence(None) == ""
    assert "noise" in noise_sentence(np.ones(7))
    assert noise_sentence(np.array([1.0, 1, 1, 3.12, 1, 1, 1])) == "Joint 4 is 3.12 × its noise."


# ---- the screen


@pytest.mark.parametrize(
    ("value", "shown"),
    [(0.0, "·····│·····"), (1.0, "·····│█████"), (-0.5, "···██│·····"), (5.0, "·····│█████")],
)
def test_a_bar_reaches_as_far_as_the_share_of_the_limit(value: float, shown: str) -> None:
    assert bar(value, -1.0, 1.0).plain == shown


def test_a_bar_is_red_near_its_limit_and_never_longer_than_its_room() -> None:
    assert "red" in str(bar(0.95, -1.0, 1.0).style)
    assert "green" in str(bar(0.5, -1.0, 1.0).style)
    assert len(bar(1e9, -1.0, 1.0, mark=-1e9).plain) == 11


def test_the_time_that_remains_is_that_of_the_periods_left() -> None:
    assert remaining_s(frame(period=1, sample_in_period=250)) == pytest.approx(2.75)
    assert remaining_s(frame(phase="START_RAMP", period=-1, sample_in_period=-1)) == pytest.approx(4.0)
    assert remaining_s(frame(phase="HOLD")) is None


def text_of(screen: Screen, width: int) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width, color_system=None).print(drawn(screen))
    return stream.getvalue()


def full_screen(width: int, *, ascii_only: bool = False) -> Screen:
    """With the longest numbers there are."""
    return Screen(
        frame(position=(-2.9,) * 7, torque=(-310.25,) * 7, external_torque=(-59.99,) * 7, received=1_234_567,
              session_state="COMMANDING_ACTIVE", quality="EXCELLENT", period=15, periods=16),
        limits_for("iiwa14"), velocity=np.full(7, -1.234), modelled=np.full(7, -299.75), ratio=np.full(7, 12.3),
        width=width, ascii_only=ascii_only,
    )  # fmt: skip


@pytest.mark.parametrize("width", [80, 100, 130])
@pytest.mark.parametrize("ascii_only", [False, True])
def test_a_screen_fits_its_terminal_and_cuts_no_number(width: int, ascii_only: bool) -> None:
    screen = full_screen(width, ascii_only=ascii_only)
    text = text_of(screen, width)
    assert "…" not in text
    assert all(len(line) <= width for line in text.splitlines())
    assert len(text.splitlines()) <= 12
    for number in ("-2.900", "-1.234", "-310.25", "-10.50", "12.3", "-59.99"):
        assert text.count(number) >= 7
    if ascii_only:
        assert text.isascii()


@pytest.mark.parametrize("width", [24, 40, 60, 76])
def test_a_terminal_too_narrow_for_bars_keeps_every_joint_and_its_numbers(width: int) -> None:
    """Before, the names of the joints were cut to one sign, and the numbers behind the velocity were gone."""
    numbers = ["-2.900", "-1.234", "-310.25", "-10.50", "12.3", "-59.99"]
    text = text_of(full_screen(width), width)
    rows = [line.split() for line in text.splitlines() if line.startswith("A")]
    assert rows == [[f"A{joint}", *numbers[: (width - 2) // 8]] for joint in range(1, 8)]
    assert "…" not in text


@pytest.mark.parametrize("width", [30, 40, 60, 79])
def test_lines_on_a_narrow_terminal_end_between_facts_and_in_none(width: int) -> None:
    """Before, "period 3 of" stood at the end of a line and "16" on the next, and the bar went round the corner."""
    screen = replace(full_screen(width), silent_s=3.0)
    lines = [line.rstrip() for line in text_of(screen, width).splitlines()]
    whole = [line.rstrip() for line in text_of(replace(screen, width=200), 200).splitlines()]
    heads = [fact for line in (whole[0], whole[2]) for fact in re.split("  +", line)]
    said = [fact for line in lines for fact in re.split("  +", line)]
    assert [fact for fact in said if fact in heads] == heads
    assert sum("remain" in line and "━" in line for line in lines) == 1


def test_joints_stay_where_they_were_last_seen_when_the_robot_is_silent() -> None:
    watcher = Watcher()
    watcher.take([frame(robot_time_s=0.01 * place) for place in range(3)])
    watcher.take([frame(position=None, torque=None, external_torque=None, received=42)])
    screen = watcher.screen()
    assert screen is not None
    assert screen.frame.received == 42
    assert screen.frame.position == (0.1,) * 7
