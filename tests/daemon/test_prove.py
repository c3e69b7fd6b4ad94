"""Claims about the proof: that the diagnosing side is blind, that a seal binds, and what its processes leave.

What is scored as right: `test_prove_score`.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from daemon.errors import ProofProcessError, SealBrokenError
from daemon.proof import prove as proof
from daemon.proof.page import proof_page
from daemon.proof.table import summary
from daemon.seal import opened
from fixtures.cases.plan import plan_of
from identification.report.page import render

TUNING_SEED = 21


def unheard(name: str, commitment: str) -> None:
    """Where nobody listens to what is published."""


STUB = """
import json, os, sys
for line in sys.stdin:
    request = json.loads(line)
    with open(sys.argv[1], "a") as log:
        log.write(json.dumps({"request": request, "argv": sys.argv[2:], "beside": sorted(
            os.listdir(os.path.dirname(request["recordings"][0])))}) + "\\n")
    nothing = {"baseline": {"detected": [False] * 7}, "findings": []}
    print(json.dumps({"diagnosis": nothing, "seconds": 0.5}), flush=True)
"""


def test_the_diagnosing_side_sees_two_recordings_and_nothing_else(tmp_path: Path) -> None:
    stub, log = tmp_path / "stub.py", tmp_path / "log"
    stub.write_text(STUB)
    published: list[tuple[str, str, int]] = []

    def publish(name: str, commitment: str) -> None:
        published.append((name, commitment, len(log.read_text().splitlines()) if log.exists() else 0))

    proven = proof.prove(proof.Source(TUNING_SEED), [0, 1, 3], jobs=1, worker=[str(stub), str(log)], publish=publish)
    seen = [json.loads(line) for line in log.read_text().splitlines()]
    assert [entry[2] for entry in published] == [0, 1, 2]  # each hash is out before its recordings are looked at
    for entry, case in zip(seen, proven, strict=True):
        assert set(entry["request"]) == {"recordings", "heldout"}
        assert entry["beside"] == ["A.npz", "B.npz"]
        folder = Path(entry["request"]["recordings"][0]).parent
        assert folder.name == case.name
        assert not folder.exists()
    assert [case.index for case in proven] == [0, 1, 3]
    assert {case.commitment for case in proven} == {commitment for _, commitment, _ in published}


def test_when_the_time_is_up_no_case_is_begun(tmp_path: Path) -> None:
    stub = tmp_path / "stub.py"
    stub.write_text(STUB)
    late = proof.prove(
        proof.Source(TUNING_SEED), [0, 1], jobs=1, worker=[str(stub), "log"], publish=unheard, minutes=0.0
    )
    assert late == []
    assert summary([case.score for case in late])["cases"] == 0


def test_a_label_that_was_changed_after_sealing_voids_the_proof() -> None:
    text = json.dumps({"group": "negative"})
    commitment = hashlib.sha256(("salt" + text).encode()).hexdigest()
    with pytest.raises(SealBrokenError, match="void"):
        opened("a", commitment, {"salt": "salt", "label": text.replace("negative", "single")})


def test_a_worker_that_dies_costs_its_case_and_no_other(tmp_path: Path) -> None:
    stub, log = tmp_path / "dies.py", tmp_path / "log"
    stub.write_text(
        "import os\nif not os.path.exists(__import__('sys').argv[1]):\n"
        "    input(); open(__import__('sys').argv[1], 'w').close(); os.kill(os.getpid(), 9)\n" + STUB
    )
    first, second = proof.prove(
        proof.Source(TUNING_SEED), [0, 1], jobs=1, worker=[str(stub), str(log)], publish=unheard
    )
    assert first.diagnosis is None
    assert first.error is not None
    assert "code -9" in first.error
    assert second.error is None


def test_ctrl_c_waits_for_no_case_and_begins_none(tmp_path: Path) -> None:
    """The stub says whenever it was let go on to the end of its case; nothing but a kill keeps it from that."""
    stub, log = tmp_path / "stub.py", tmp_path / "log"
    stub.write_text("import sys\nsys.stdin.read()\nopen(sys.argv[1], 'w').close()\n")

    def interrupt(name: str, commitment: str) -> None:
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        proof.prove(proof.Source(TUNING_SEED), [0, 1], jobs=1, worker=[str(stub), str(log)], publish=interrupt)
    assert not log.exists()


@pytest.mark.parametrize(
    ("arguments", "request_"),
    [(proof.WORKER, {"recordings": ["a"], "heldout": []}), (proof.Source(TUNING_SEED).arguments, {"plan": 0})],
)
def test_the_processes_of_a_proof_that_was_killed_end_without_a_word(
    arguments: tuple[str, ...], request_: dict[str, Any]
) -> None:
    reads, writes = os.pipe()
    os.close(reads)
    words, line = [sys.executable, *arguments], json.dumps(request_) + "\n"
    child = subprocess.run(words, input=line, stdout=writes, stderr=subprocess.PIPE, text=True)
    os.close(writes)
    assert (child.returncode, child.stderr) == (-signal.SIGPIPE, "")


def test_the_report_is_written_only_where_it_is_asked_for(tmp_path: Path) -> None:
    stub, log = tmp_path / "stub.py", tmp_path / "log"
    stub.write_text(STUB)
    proof.prove(proof.Source(TUNING_SEED), [0], jobs=1, worker=[str(stub), str(log)], report=True, publish=unheard)
    (seen,) = (json.loads(line) for line in log.read_text().splitlines())
    assert Path(seen["request"]["report"]).parent == Path(seen["request"]["recordings"][0]).parent


def test_pages_are_kept_under_the_cases_numbers_and_one_page_leads_to_them(tmp_path: Path) -> None:
    stub, pages = tmp_path / "stub.py", tmp_path / "proof"
    stub.write_text(STUB.replace("    nothing", "    open(request['report'], 'w').close()\n    nothing"))
    pages.mkdir()
    proven = proof.prove(
        proof.Source(TUNING_SEED),
        [0, 3],
        jobs=1,
        worker=[str(stub), str(tmp_path / "log")],
        pages=pages,
        publish=unheard,
    )
    assert sorted(file.name for file in pages.iterdir()) == ["case-0000.html", "case-0003.html"]
    text = render(proof_page(proof.Source(TUNING_SEED), proven, {0: "case-0000.html"}))
    assert '<a href="case-0000.html">case 0</a>' in text
    assert "case-0003.html" not in text
    for case in proven:
        for effect in case.label["effects"]:
            assert effect["family"] in text


def test_without_the_keeper_of_the_labels_there_is_no_proof(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keeper = tmp_path / "keeper.py"
    keeper.write_text("import sys; sys.exit(3)")
    monkeypatch.setattr(proof, "GENERATOR", (str(keeper),))
    with pytest.raises(ProofProcessError, match="code 3"):
        proof.prove(proof.Source(TUNING_SEED), [0], jobs=1, worker=[str(keeper)], publish=unheard)


def test_strong_effects_are_named_and_negatives_are_left_alone() -> None:
    """End to end with the real diagnosis, on cases that nobody should get wrong: strong ones, and nothing hidden."""
    indices = [_strong("drift"), _strong("poslow")]
    indices += proof.select_cases(proof.Source(TUNING_SEED), 1, "negative")
    proven = proof.prove(proof.Source(TUNING_SEED), indices, jobs=1, publish=unheard)
    for case in proven:
        assert case.error is None
        if case.label["effects"]:
            assert case.score.effects[0].named, case.score
        else:
            assert case.score.claimed == ()


def _strong(family: str) -> int:
    """The first case of a family, alone on a designed motion, of textbook form, at λ near 1000."""
    return next(
        index
        for index in range(5000)
        if (plan := plan_of(TUNING_SEED, index)).families == (family,)
        and (plan.group, plan.excitation, plan.grades, plan.perturbed) == ("single", "paper", (1e3,), (False,))
    )
