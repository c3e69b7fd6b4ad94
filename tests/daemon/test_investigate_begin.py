"""Claims about how an investigation begins. Truth: what its own refusal says is enough."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from daemon.errors import ConfigurationError
from daemon.investigate.begin import begun
from identification.errors import RecordingNotFoundError


@pytest.mark.parametrize("given", range(4))
def test_the_least_budget_that_is_said_is_enough(tmp_path: Path, given: int) -> None:
    """With one recording at hand 80 s are enough; 1.3 minutes were said to be the least, and refused."""
    files = [tmp_path / f"{number}.npz" for number in range(given)]  # read once the budget is long enough
    with pytest.raises(ConfigurationError, match="too short") as refused:
        begun(files, "iiwa14", 6.0, 1)
    least = re.search(r"([\d.]+) are the least", str(refused.value))
    assert least is not None
    seconds = 60.0 * float(least[1])
    if given:
        with pytest.raises(RecordingNotFoundError):
            begun(files, "iiwa14", seconds, 1)
    else:
        assert begun(files, "iiwa14", seconds, 1).budget_s == seconds
