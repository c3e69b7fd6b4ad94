"""kill -9 of each process of a run at a moment that nobody chose; many more: `python -m benchmarks.kills`."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.kills import Moment, draw, play

MOMENTS = draw(4, seed=20261122, messages=4500, periods=1)


@pytest.mark.parametrize("moment", MOMENTS, ids=str)
def test_the_arm_comes_to_rest_and_every_sample_is_accounted_for(moment: Moment, tmp_path: Path) -> None:
    result, wrong = play(moment, 0, tmp_path)
    assert not wrong, (wrong, result.transcript)
