"""Claims about the check before a run of the queue: whose folder it writes into.

Truth: what stood in the folder before.
"""

from __future__ import annotations

from pathlib import Path

from daemon.queue.job_preparation import Preparation, PreparationJob


def preparation(out: Path, answers: Path) -> Preparation:
    return Preparation(
        PreparationJob(
            job_id="20261126T153243301Z",
            trajectory_file=None,
            robot="iiwa14",
            amplitude=0.1,
            out_dir=str(out),
            answer_dir=str(answers),
            settings={"tool": "nothing that is known/", "periods": 1},  # so that nothing is checked for long
        )
    )


def test_two_services_that_give_one_number_in_one_millisecond_do_not_share_a_folder(tmp_path: Path) -> None:
    """Else an arm drives the table that was checked in the cell of another."""
    out = tmp_path / "runs" / "20261126T153243301Z"
    first, _ = preparation(out, tmp_path / "jobs-1").run()
    (out / "table.npy").write_text("the first arm's")
    second, request = preparation(out, tmp_path / "jobs-2").run()
    assert "belongs to another service" not in first.sentence
    assert (second.safe, second.exit_code, request) == (False, 74, None)
    assert "belongs to another service or run: submit this one again" in second.sentence
    assert (out / "table.npy").read_text() == "the first arm's"
    again, _ = preparation(out, tmp_path / "jobs-1").run()  # held and let go again
    assert "belongs to another service" not in again.sentence
