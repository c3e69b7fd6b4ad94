"""What a class does to held-out rows, in words."""

from __future__ import annotations

import pytest

from identification.mismatch.unknown.forms import on_unseen_rows


@pytest.mark.parametrize(
    ("gain", "said"),
    [(0.02, "lowers the RMS by 0.02 Nm."), (-0.02, "RAISES the RMS by 0.02 Nm."), (-1.6e-7, "hardly changes the RMS.")],
)
def test_a_change_that_base_parameters_may_cause_as_well_is_none(gain: float, said: str) -> None:
    """A class was said to RAISE the RMS by 1.6e-07 Nm."""
    assert on_unseen_rows(gain, 0.05, "the RMS").endswith(said)
