"""Claims about docs/formats.md: it names every key that is written, and no other.

Truth: results built here with every part filled in, written by the code as users get them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from daemon.api import FileDigest, LoopReport, PhaseSpan, RunOutcome
from fixtures.judge.log import judge_log
from identification.audit.difference import Audit, Difference, Number
from identification.excitation.nominal import nominal_parameters
from identification.mismatch.baseline import LinkDeviation, ModelComparison, ParameterDeviation
from identification.mismatch.findings import Alternative, DataFault, HeldOutMisfit
from identification.mismatch.second_encoder import EncoderDifference
from identification.mismatch.unknown.claims import AngleCurve, ClassClaim, ClassCurve, ClassModel, NearestForm, Offer
from identification.recording_fit import FitSettings, fit_recordings
from identification.robots import Installation, load_robot
from tests.daemon.producer import make_request
from tests.fixtures.judged_log import line, write_log
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of
from tests.identification.test_report_diagnosis import diagnosis, finding

PAGE = Path(__file__).resolve().parents[1] / "docs" / "formats.md"
Json = dict[str, Any]


def described(file: str) -> dict[str, set[str]]:
    """Keys by the place they stand in ("" is the top), as the page's part on one file has them."""
    _, _, part = PAGE.read_text(encoding="utf-8").partition(f"\n## {file}\n")
    places: dict[str, set[str]] = {}
    here = [""]
    for row in re.split(r"\n## ", part)[0].splitlines():
        if row.startswith("### "):
            here = re.findall(r"`(.+?)`", row)
        elif row.startswith("| `"):
            for place in here:
                places.setdefault(place, set()).update(re.findall(r"`(.+?)`", row.split(" | ")[0]))
    for place in list(places):
        while place:
            place, _, key = place.rpartition(".")
            places.setdefault(place, set()).add(key.removesuffix("[]"))
    return places


def at(results: list[Json], place: str) -> list[Json]:
    """The objects that stand at a place, such as `findings[].alternatives[]`, in all results."""
    for key in place.split(".") if place else ():
        found = [item[key.removesuffix("[]")] for item in results if item.get(key.removesuffix("[]")) is not None]
        results = [each for item in found for each in item] if key.endswith("[]") else found
    return results


def check(file: str, results: list[Json]) -> None:
    for place, keys in described(file).items():
        assert {key for item in at(results, place) for key in item} == keys, f"{file}: {place or 'top'}"


def full_diagnosis() -> Any:
    three = np.full(3, 0.1)
    mass = Number("mass", 2.8, 0.05, "kg")
    load = Difference("payload", None, 6, (mass,), 0.97, 90.0, "model", "A load.", (("payload", 5),))
    late = Difference("wrong_time_base", None, None, (), 0.9, 50.0, "recording", "The clock.")
    plain = diagnosis()
    stribeck = finding(alternatives=(Alternative("presliding_hysteresis", 2),))
    assert plain.heldout is not None
    assert stribeck.curve is not None
    return replace(
        plain,
        findings=(stribeck,),
        data_faults=(DataFault("inverted_torque_sign", (3,), "Turned."),),
        heldout=replace(plain.heldout, misfits=(HeldOutMisfit("a.mcap", 1, 2.0, 0.1, True, "Joint 1."),)),
        classes=(
            ClassClaim("own_position", 2, 0.1, (0.08, 0.12), 20.0, three, ("configuration",),
                       (NearestForm("cable_spring", 0.5),), "Joint 2.", ClassCurve("position", "rad", *[three] * 3)),
            ClassClaim("own_load", 3, 0.1, (0.08, 0.12), 20.0, three, (), (), "Joint 3.",
                       AngleCurve("load", "Nm", *[three] * 3), angle=True, shows_on=(2, 3)),
        ),
        too_weak=(Alternative("cable_spring", 1),),
        curves=(stribeck.curve,),
        class_model=ClassModel(*[three] * 4),
        offer=Offer({"terms": []}, np.zeros(2), np.ones(2), three, three),
        audit=Audit("old.json", "named", (load, late), (5.0,), (0.3,), "A load."),
        model_comparison=ModelComparison(
            "old.json", *[three] * 4, (ParameterDeviation("FS_2", 2, 0.3, 0.1, 0.01, "Nm", 0.2),),
            (LinkDeviation(2, 1e-6, 0.2),),
        ),
        encoders=(EncoderDifference(1, "delay", 1e-3, {"delay": 0.1}, 1e-3, 0.0),),
    )  # fmt: skip


def test_the_page_names_every_key_of_a_diagnosis() -> None:
    check("diagnosis.json", [full_diagnosis().to_json()])


def test_the_page_names_every_key_of_a_run(tmp_path: Path) -> None:
    judgement = judge_log(write_log(tmp_path / "log.mcap", line(400, 1.6))).to_json()
    outcome = RunOutcome(
        run_id="one", outcome="completed", exit_code=1, sentences=(), out_dir="runs/one", judgement=judgement,
        loop=LoopReport(outcome="completed", reason="", sentence="", phases=(PhaseSpan(phase="HOLD"),)),
        files=(FileDigest(name="a", bytes=1, sha256=""),), request=make_request(tmp_path),
    )  # fmt: skip
    unjudged = msgspec.structs.replace(outcome, judgement={"error": "It could not be judged."})
    check("run.json", [msgspec.to_builtins(outcome), msgspec.to_builtins(unjudged)])


@pytest.mark.filterwarnings("ignore")
def test_the_page_names_every_key_of_a_model() -> None:
    robot = load_robot("iiwa14", Installation((9.81, 0.0, 0.0)))
    nominal = nominal_parameters(robot)
    assert nominal is not None
    q, dq, ddq = fourier_motion(7, period_s=10.0, samples=1000, seed=1)
    torque = inverse_dynamics(robot, nominal, q, dq, ddq)
    torque += np.random.default_rng(1).normal(scale=0.1, size=torque.shape)
    settings = FitSettings(starts=1, offset="yes", split="first:0.6", pipeline="aperiodic")
    fitted = fit_recordings([recording_of(q, torque, period_s=10.0)], robot, settings).to_model_json()
    check("model.json", [fitted, full_diagnosis().extended_model_json()])
