"""Claims about how an investigation begins. Truth: what its own refusal says is enough."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from daemon.errors import ConfigurationError
from daemon.investigate.begin import begun
from daemon.investigate.states import State
from identification.errors import RecordingNotFoundError
from tests.daemon.scripted_investigation import ScriptedDriver, investigation
from tests.daemon.scripted_investigation import begun as first_of


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


def test_a_shipped_motion_that_is_not_safe_is_no_choice_of_motions(tmp_path: Path) -> None:
    """Of one motion that nobody chose it was said that none of those tried is safe, and to add one to this folder."""
    account = first_of(tmp_path, recordings=(), budget_s=600.0)
    driver = ScriptedDriver(objection="Link 7 meets the fence.")
    told = investigation(tmp_path, account, driver).run()
    assert told.state is State.BLOCKED
    assert "the shipped excitation, is not safe here: Link 7 meets the fence." in told.sentence
    assert "tried" not in told.sentence
    assert "begin anew with --from" in told.sentence
