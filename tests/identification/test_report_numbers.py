"""Numbers of the report say what they mean: σ with two digits, the value to the same place, nothing invented."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.report.numbers import listed, rounded, with_sigma

SIZES = st.floats(1e-5, 1e5)
VALUES = st.one_of(SIZES, SIZES.map(lambda value: -value))


def number(text: str) -> Decimal:
    return Decimal(text.replace("−", "-"))


@given(VALUES, st.floats(1e-6, 1e3))
def test_value_and_sigma_end_at_the_same_place_and_lose_less_than_half_of_it(value: float, sigma: float) -> None:
    texts = with_sigma(value, sigma)
    shown, deviation = (number(text) for text in texts)
    place = Decimal(1).scaleb(deviation.adjusted() - 1)
    assert abs(shown - Decimal(value)) <= Decimal("0.5001") * place
    assert abs(deviation - Decimal(sigma)) <= Decimal("0.5001") * place
    assert shown.as_tuple().exponent == deviation.as_tuple().exponent


@pytest.mark.parametrize(
    ("value", "sigma", "expected"),
    [
        (5.816782, 0.000691, ("5.81678", "0.00069")),
        (12.3456, 0.0999, ("12.35", "0.10")),
        (-0.00001, 0.0019, ("0.0000", "0.0019")),
        (1234.5, 120.0, ("1230", "120")),
        (0.5, float("nan"), ("0.5000", "–")),
        (float("nan"), 0.1, ("–", "–")),
        (None, 0.1, ("–", "–")),
    ],
)
def test_value_with_sigma_as_in_a_paper(value: float | None, sigma: float, expected: tuple[str, str]) -> None:
    assert with_sigma(value, sigma) == expected


@given(VALUES, st.integers(1, 5))
def test_rounded_number_has_the_digits_asked_for(value: float, digits: int) -> None:
    shown = number(rounded(value, digits))
    assert abs(shown - Decimal(value)) <= Decimal("0.5001") * Decimal(1).scaleb(shown.adjusted() - digits + 1)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.124567, "0.125"), (0.0, "0"), (-8e-78, "0"), (1e9, "1.00e+09"), (float("inf"), "–"), (None, "–")],
)
def test_rounding_of_special_numbers(value: float | None, expected: str) -> None:
    assert rounded(value) == expected


def test_items_as_in_a_sentence() -> None:
    assert [listed(items) for items in ([], ["1"], ["1", "2"], ["1", "2", "5"])] == ["", "1", "1 and 2", "1, 2 and 5"]
