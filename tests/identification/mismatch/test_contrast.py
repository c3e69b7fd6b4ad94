"""The size of what stays on a joint beside other joints. Truth: closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from identification.mismatch.heldout import Residuals
from identification.mismatch.names.verdict import contrast, contrast_by_band
from identification.mismatch.settings import DiagnosisSettings


def _residuals(rows: np.ndarray) -> Residuals:
    """Rows (3, 100) in units of the noise."""
    one = np.ones((3, 100))
    return Residuals(
        rows=rows, noise=one, sensor_noise=one, used=one > 0.0, samples=100, scatter=np.zeros((*rows.shape, 0))
    )


def test_contrast_is_what_goes_on_the_joint_over_what_stays_elsewhere() -> None:
    def of(squares: list[float]) -> Residuals:
        return _residuals(np.sqrt(np.array(squares))[:, None] * np.ones((3, 100)) / 10.0)

    without, with_it = of([900.0, 200.0, 150.0]), of([100.0, 200.0, 150.0])
    assert contrast(without, with_it, [0]) == pytest.approx(800.0 / 100.0)


def test_band_by_band_only_the_bands_that_another_joint_leaves_alone_count() -> None:
    """Joint 2 keeps 100 times the noise in the low band and the noise itself in the high one."""
    band = np.repeat([0, 1], 50)
    left = np.ones((3, 100))
    left[1, :50] = 10.0
    low, high = left.copy(), left.copy()
    low[0, :50] = high[0, 50:] = 10.0
    now, settings = _residuals(left), DiagnosisSettings(contrast_to_background=4.0)
    seen = contrast_by_band(_residuals(high), now, [0], band, settings)
    assert seen == pytest.approx(25.0 * np.log(104.0 / 5.0))
    assert contrast_by_band(_residuals(low), now, [0], band, settings) == pytest.approx(25.0 * np.log(500.0 / 401.0))
