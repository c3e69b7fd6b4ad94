"""Claims about a series of recordings: friction by date, and the step in it.

Truth: Pinocchio's torque of the paper's arm whose joint 4 rubs more from the fourth recording on; drawn series.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from identification.audit.trend import (
    SCATTERS,
    STEP_WIDTH,
    JointTrend,
    Trend,
    change_point,
    date_of,
    hours_of,
    trend_of,
    with_hours,
)
from identification.errors import RecordingError
from identification.physical_parameters import PhysicalParameters
from identification.recordings import Recording
from identification.report.document import Figure, Paragraph, Table
from identification.report.series_notes import notes_on_order, notes_on_temperature, notes_on_the_first
from identification.report.trend_page import trend_document, trend_order
from identification.robots import RobotModel
from tests.identification.synthetic import coloured_noise, fourier_motion, inverse_dynamics, recording_of

MORE_NM = 0.15
FROM = 3


@pytest.fixture(scope="module")
def series(iiwa14: RobotModel, table3: PhysicalParameters) -> list[Recording]:
    """Five runs of ten seconds on five days, given in no order of time; joint 4's friction is larger from run 4 on."""
    states = fourier_motion(7, period_s=10.0, samples=1000, seed=3)
    bare, found = inverse_dynamics(iiwa14, table3, *states), []
    for day in range(5):
        torque = bare + coloured_noise(bare.shape, deviation=0.05, correlation=0.5, seed=40 + day)
        torque[:, 3] += (day >= FROM) * MORE_NM * np.sign(states[1][:, 3])
        recording = recording_of(states[0], torque, period_s=10.0)
        tags = {"run_id": f"2026060{day + 1}T080000123Z", "operating_hours": f"{1200.5 + 24 * day}"}
        found.append(replace(recording, source=replace(recording.source, path=f"day{day + 1}.npz", metadata=tags)))
    return [found[place] for place in (4, 0, 2, 1, 3)]


@pytest.fixture(scope="module")
def trend(series: list[Recording], iiwa14: RobotModel) -> Trend:
    return trend_of(series, iiwa14)


def test_the_day_on_which_friction_changed_is_found(trend: Trend) -> None:
    assert trend.names == tuple(f"day{day}.npz" for day in range(1, 6))
    elbow = trend.joints[3]
    assert (elbow.change.at, elbow.change.odds > 20.0) == (FROM, True)
    assert elbow.change.size == pytest.approx(MORE_NM, abs=0.02)
    assert "before day4.npz" in elbow.sentence(trend.names)
    assert all(item.change.odds < 20.0 for item in trend.joints if item.joint != 4)
    document = trend_document(trend, "iiwa14")
    assert document.verdict == "Friction changed at once on joint 4."
    assert trend.hours == (1200.5, 1224.5, 1248.5, 1272.5, 1296.5)
    titles = [block.caption for section in document.sections for block in section.blocks if isinstance(block, Figure)]
    assert titles == ["Friction of each recording", "Friction by hours of operation"]


def test_recordings_of_a_series_are_called_by_as_many_folders_as_tell_them_apart(
    series: list[Recording], iiwa14: RobotModel
) -> None:
    paths = [f"{arm}/{month}/recording.mcap" for arm in ("left", "right") for month in ("may", "june")]
    of_two_arms = [
        replace(run, source=replace(run.source, path=path, metadata={}))
        for run, path in zip(series[:4], paths, strict=True)
    ]
    assert trend_of(of_two_arms, iiwa14).names == tuple(paths)


@pytest.mark.parametrize(
    ("apart_s", "unit", "last"), [(86400.0, "days", 4.0), (3600.0, "hours", 4.0), (90.0, "minutes", 6.0)]
)
def test_a_series_is_drawn_in_a_unit_of_time_that_it_lasts(
    trend: Trend, apart_s: float, unit: str, last: float
) -> None:
    begun = datetime(2026, 3, 1, tzinfo=UTC)
    dated = replace(trend, dates=tuple(begun + k * timedelta(seconds=apart_s) for k in range(5)))
    figure = next(
        block
        for section in trend_document(dated, "iiwa14").sections
        for block in section.blocks
        if isinstance(block, Figure)
    )
    assert figure.panels[0].x_label.startswith(f"{unit} since 2026-03-01")
    assert figure.panels[0].lines[0].x[-1] == pytest.approx(last)


def test_a_series_without_dates_is_in_the_order_of_its_hours(series: list[Recording], iiwa14: RobotModel) -> None:
    undated = [
        replace(
            item, source=replace(item.source, metadata={"operating_hours": item.source.metadata["operating_hours"]})
        )
        for item in series
    ]
    trend = trend_of(undated, iiwa14)
    assert trend.dates is None
    assert trend.names == tuple(f"day{day}.npz" for day in range(1, 6))
    (figure, *_) = trend_document(trend, "iiwa14").sections[0].blocks[7:]
    assert isinstance(figure, Figure)
    assert figure.panels[0].x_label == "recording, by hours of operation"
    one_unsaid = [replace(undated[0], source=replace(undated[0].source, metadata={})), *undated[1:]]
    assert trend_of(one_unsaid, iiwa14).hours is None
    with pytest.raises(RecordingError, match="2 hours of operation are given for 5 recordings"):
        with_hours(undated, [1.0, 2.0])
    assert [hours_of(item) for item in with_hours(undated, [5.0, 4.0, 3.0, 2.0, 1.0])] == [5.0, 4.0, 3.0, 2.0, 1.0]


def test_hours_of_one_arm_do_not_fall_with_the_date(series: list[Recording]) -> None:
    """The counter of the cabinet shows whole hours, so that two may be equal; each arm has one of its own."""
    days = sorted(series, key=lambda item: str(item.source.path))
    with pytest.raises(
        RecordingError, match=r"1410 are given for day3\.npz, and 1296 for day4\.npz, which is of a later"
    ):
        with_hours(days, [1200.0, 1296.0, 1410.0, 1296.0, 1533.0])
    assert [hours_of(item) for item in with_hours(days, [7.0, 7.0, 8.0, 8.0, 9.0])] == [7.0, 7.0, 8.0, 8.0, 9.0]
    of_two_arms = [
        replace(item, source=replace(item.source, metadata={**item.source.metadata, "serial": "AB"[day % 2]}))
        for day, item in enumerate(days)
    ]
    assert len(with_hours(of_two_arms, [500.0, 100.0, 600.0, 200.0, 700.0])) == 5


def test_a_steady_series_has_a_step_as_seldom_as_the_odds_say() -> None:
    generator = np.random.default_rng(20261122)
    said = [change_point(1.0 + 0.02 * generator.standard_normal(8), np.full(8, 0.005)).odds > 20.0 for _ in range(100)]
    # Odds of 20 : 1 for a step are wrong in one series of 20 at most.
    assert sum(said) <= 5


def test_a_step_of_many_deviations_is_placed_and_its_size_covered() -> None:
    generator = np.random.default_rng(11)
    held = []
    for _ in range(40):
        at, size = int(generator.integers(2, 8)), float(generator.choice([-1, 1]) * generator.uniform(0.15, 0.5))
        values = 1.0 + 0.02 * generator.standard_normal(10) + size * (np.arange(10) >= at)
        found = change_point(values, np.full(10, 0.005))
        assert (found.at, found.odds > 20.0) == (at, True)
        held.append(abs(found.size - size) < 1.96 * found.std)
    # 40 intervals of 95 %: fewer than 33 that hold have a chance below one in a thousand.
    assert sum(held) >= 33


def test_a_steady_drift_is_no_change_at_once(trend: Trend) -> None:
    generator = np.random.default_rng(12)
    drawn = [
        change_point(1.0 + 0.03 * np.arange(12) + 0.02 * generator.standard_normal(12), np.full(12, 0.01))
        for _ in range(40)
    ]
    assert not any(found.odds > 20.0 for found in drawn)
    assert all(found.drift_odds > 20.0 for found in drawn)
    assert sum(abs(found.drift - 0.33) < 1.96 * found.drift_std for found in drawn) >= 33
    worn = replace(trend, joints=(replace(trend.joints[0], change=drawn[0]), *trend.joints[1:]))
    assert "friction drifts from recording to recording" in worn.sentences[0]
    assert trend_document(worn, "iiwa14").verdict.endswith("It drifts on joint 1.")


@pytest.mark.parametrize("step", [0.0, 0.2])
def test_odds_are_those_of_the_evidence_summed_by_hand(step: float) -> None:
    """Truth: the integrals over mean and change on a grid."""
    values = 1.0 + 0.05 * np.random.default_rng(3).standard_normal(5) + step * (np.arange(5) >= 3)
    size = np.abs(values).mean()
    mean, change = np.linspace(-9.0, 9.0, 901) * size, np.linspace(-3.0, 3.0, 601) * size
    prior = np.exp(-0.5 * (mean[:, None] / (3.0 * size)) ** 2 - 0.5 * (change / (STEP_WIDTH * size)) ** 2)

    def evidence(shape: np.ndarray) -> float:
        total = 0.0
        for scatter in SCATTERS * size:
            variance = 0.02**2 + scatter**2
            left = values[:, None, None] - mean[:, None] - change * shape[:, None, None]
            total += float((prior * np.exp(-0.5 * (left**2).sum(axis=0) / variance)).sum() / variance**2.5)
        return total

    none, drift = evidence(np.zeros(5)), evidence(np.linspace(0.0, 1.0, 5))
    steps = [evidence((np.arange(5) >= at).astype(float)) for at in range(1, 5)]
    found = change_point(values, np.full(5, 0.02))
    assert found.at == 1 + int(np.argmax(steps))
    assert found.odds == pytest.approx(np.mean(steps) / max(none, drift), rel=1e-6)
    assert found.drift_odds == pytest.approx(drift / max(none, np.mean(steps)), rel=1e-6)


def test_a_series_of_two_arms_says_so(series: list[Recording], iiwa14: RobotModel, trend: Trend) -> None:
    mixed = [
        replace(item, source=replace(item.source, metadata={**item.source.metadata, "serial": serial}))
        for item, serial in zip(series, ("A1", "B2", "A1", "", "B2"), strict=True)
    ]
    of_two = trend_of(mixed, iiwa14)
    assert of_two.sentences[0].startswith("These are recordings of 2 arms (serial numbers A1, B2)")
    assert of_two.to_json()["arms"] == ["A1", "B2"]
    assert len(trend.sentences) == 7


def test_three_recordings_are_no_series(series: list[Recording], iiwa14: RobotModel) -> None:
    with pytest.raises(RecordingError, match="4 recordings or more, not 3"):
        trend_of(series[:3], iiwa14)


def test_dates_come_from_the_run_or_from_the_file(series: list[Recording]) -> None:
    assert date_of(series[0]) == datetime(2026, 6, 5, 8, tzinfo=UTC)
    told = replace(series[0], source=replace(series[0].source, metadata={"date": "2026-05-04T10:00:00"}))
    assert date_of(told) == datetime(2026, 5, 4, 10, tzinfo=UTC)
    zoned = replace(series[0], source=replace(series[0].source, metadata={"date": "2026-05-04T10:00:00.5+02:00"}))
    assert date_of(zoned) == datetime(2026, 5, 4, 8, 0, 0, 500000, tzinfo=UTC)
    remarked = replace(series[0], source=replace(series[0].source, metadata={"date": "2026-05-04T10:00:00 (lab 2)"}))
    assert date_of(remarked) == datetime(2026, 5, 4, 10, tzinfo=UTC)
    for never_set in ("0001-01-01T00:00:00+14:00", "1970-01-01T00:02:10"):
        clock = replace(series[0], source=replace(series[0].source, metadata={"date": never_set}))
        assert date_of(clock) is None
    unsaid = replace(series[0], source=replace(series[0].source, metadata={}))
    assert date_of(unsaid) is None


@pytest.mark.parametrize(
    ("step", "said"), [(0.4, "no change at once that is sure, which takes 20 : 1"), (0.0, "no change at once (")]
)
def test_a_likely_change_is_not_said_to_be_none(step: float, said: str) -> None:
    """Of a step with odds of 14 : 1 it was said that there is no change at once."""
    values = 9.225 + np.array([0.003, -0.003, 0.0, step - 0.001, step - 0.005, step])
    change = change_point(values, np.full(6, 0.004))
    assert change.odds < 20.0
    assert (change.odds > 1.0) == (step > 0.0)
    joint = JointTrend(2, 0.41, values, np.full(6, 0.004), np.full(6, np.nan), change)
    assert said in joint.sentence("abcdef")
    verdict = trend_document(Trend(tuple("abcdef"), None, None, (joint,)), "arm").verdict
    assert verdict == f"No joint's friction changed at once{' for sure' if step else ''}."


def test_a_sliding_joint_rubs_in_newtons_at_metres_a_second() -> None:
    values, std = 14.0 + np.array([0.0, 0.0, 0.0, 6.0, 6.0, 6.0]), np.full(6, 0.01)
    joints = tuple(
        JointTrend(joint, 0.059, values, std, np.full(6, np.nan), change_point(values, std)) for joint in (1, 2)
    )
    trend = Trend(tuple("abcdef"), None, None, joints, units=("Nm", "N"))
    assert " Nm at 0.059 rad/s before d" in trend.sentences[0]
    assert " N at 0.059 m/s before d" in trend.sentences[1]
    assert [item["sentence"] for item in trend.to_json()["joints"]] == list(trend.sentences)
    (section,) = trend_document(trend, "scara").sections
    (figure,) = (block for block in section.blocks if isinstance(block, Figure))
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert [panel.y_label for panel in figure.panels] == ["friction at 0.059 rad/s (Nm)", "friction at 0.059 m/s (N)"]
    assert table.caption.endswith("Nm (N of prismatic joints)")


def _dated(series: list[Recording], dates: list[str]) -> list[Recording]:
    """The first recordings of the series under other dates, as paths r1.npz, r2.npz, …"""
    return [
        replace(run, source=replace(run.source, path=f"r{place}.npz", metadata={"date": date}))
        for place, (run, date) in enumerate(zip(series, dates, strict=False), 1)
    ]


def test_what_dates_do_not_tell_of_the_order_is_said(series: list[Recording]) -> None:
    may = [f"2026-05-0{day}T10:00:00Z" for day in (4, 3, 2, 1)]
    assert notes_on_order(_dated(series, may)) == ()
    (older,) = notes_on_the_first(_dated(series, may))
    assert older == "r2.npz, r3.npz, r4.npz: made before r1.npz. What is called 'before' is the later one."
    assert notes_on_the_first(_dated(series, may[::-1])) == ()
    (undated,) = notes_on_order(_dated(series, [*may[:2], "", may[3]]))
    assert undated.startswith("r3.npz: no date, so the series stands as it was given; the dates of the others are in")
    (sorted_but,) = notes_on_order(_dated(series, [*may[:1:-1], "", may[0]]))
    assert sorted_but == "r3.npz: no date, so the series stands as it was given."
    (alike,) = notes_on_order(_dated(series, [may[0], may[1], may[0], may[2]]))
    assert alike == "r1.npz, r3.npz: not alone with their date. Those of one date stand as given."
    assert notes_on_order(_dated(series, ["", "", "", ""])) == ()


def test_a_series_of_one_date_is_drawn_in_its_order_and_says_so(trend: Trend) -> None:
    assert trend.dates is not None
    same = replace(trend, dates=(trend.dates[0],) * len(trend.names))
    assert (trend_order(trend), trend_order(same)) == ("by date", "as given")
    document = trend_document(same, "iiwa14", ["r3.npz: no date."])
    blocks = document.sections[0].blocks
    assert blocks[0] == Paragraph("r3.npz: no date.")
    (panel, *_), *_ = (block.panels for block in blocks if isinstance(block, Figure))
    assert (panel.x_label, panel.lines[0].x.tolist()) == ("recording, as given", [1.0, 2.0, 3.0, 4.0, 5.0])
    (table,) = (block for block in trend_document(trend, "iiwa14").sections[0].blocks if isinstance(block, Table))
    assert (table.head[1], table.rows[1][1]) == ("date (UTC)", "2026-06-02 08:00")


def test_a_change_that_comes_with_warmth_is_said_to(trend: Trend) -> None:
    elbow = trend.joints[3]
    assert elbow.change.at == FROM

    def said(*celsius: float) -> tuple[str, ...]:
        joints = (*trend.joints[:3], replace(elbow, temperature=np.array(celsius)), *trend.joints[4:])
        return notes_on_temperature(replace(trend, joints=joints))

    (note,) = said(24.0, 25.0, 26.0, 40.0, 41.0)
    assert note.startswith("Joint 4 has 25 °C before day4.npz and 40.5 °C from there on")
    assert len(said(24.0, np.nan, 26.0, np.nan, 41.0)) == 1
    for alike in ((24.0, 25.0, 26.0, 25.5, 27.0), (24.0, 25.0, 26.0, np.nan, np.nan), (np.nan,) * 5):
        assert said(*alike) == ()
    warm = replace(
        trend, joints=tuple(replace(item, temperature=np.array([24.0] * 3 + [40.0] * 2)) for item in trend.joints)
    )
    assert len(notes_on_temperature(warm)) == 1  # of the other joints no friction changed
    blocks = trend_document(warm, "iiwa14").sections[0].blocks
    assert any(isinstance(block, Paragraph) and "Joint 4 has 24 °C before" in block.text for block in blocks)
