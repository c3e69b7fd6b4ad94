"""No name stands that makes a joint of a held-out recording worse than its noise allows. Truth: residuals by hand."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from identification.mismatch import claims
from identification.mismatch.claims import harmless
from identification.mismatch.heldout import Residuals
from identification.mismatch.names.abstention import Check, Examination
from identification.mismatch.search.trial import Trial

ROWS = 200


def _residuals(added_on_joint_1: float, rms_of_joint_2: float) -> Residuals:
    """White noise of 1 Nm; on joint 1 a torque is added that has nothing to do with it, joint 2 is scaled."""
    noise, other = np.random.default_rng(4).normal(size=(2, 2, ROWS))
    rows = np.stack([noise[0] + added_on_joint_1 * other[0], rms_of_joint_2 * noise[1]])
    one = np.ones((2, ROWS))
    return Residuals(rows, one, one, np.ones((2, ROWS), dtype=np.bool_), ROWS, np.zeros((2, ROWS, 0)))


def _member(name: str, joint: int) -> Any:
    return SimpleNamespace(effect=SimpleNamespace(name=name), place=SimpleNamespace(joint=joint))


def _trial(members: Sequence[Any]) -> Trial:
    return cast(Trial, SimpleNamespace(members=tuple(members)))


@pytest.mark.parametrize(("harm", "kept"), [(1.2, ["payload"]), (0.1, ["payload", "cable_spring"])])
def test_a_name_that_makes_another_joint_worse_beyond_its_noise_is_not_claimed(
    monkeypatch: pytest.MonkeyPatch, harm: float, kept: list[str]
) -> None:
    """Payload takes joint 2 from 5 to 1 Nm; cable_spring takes it from 1.5 to 1 and adds `harm` Nm to joint 1."""
    left = {
        ("payload", "cable_spring"): _residuals(harm, 1.0),
        ("payload",): _residuals(0.0, 1.5),
        ("cable_spring",): _residuals(harm, 5.0),
        (): _residuals(0.0, 5.0),
    }

    def settled(members: Sequence[Any]) -> Check:
        return cast(Check, SimpleNamespace(heldout_after=left[tuple(item.effect.name for item in members)]))

    monkeypatch.setattr(claims, "fitted", lambda _problem, members, _settings: _trial(members))
    exam = cast(Examination, SimpleNamespace(problem=None, settings=None))
    trial, remarks = harmless(exam, _trial([_member("payload", 2), _member("cable_spring", 2)]), settled)
    assert [item.effect.name for item in trial.members] == kept
    assert [remark.startswith("cable spring of joint 2 makes joint 1 worse") for remark in remarks] == [True] * (
        2 - len(kept)
    )
