"""Claims about where a model is written: a file is replaced as a whole, a pipe or a device is left what it is.

The truth is the operating system's: what kind of file stands there, and what its other end read.
"""

from __future__ import annotations

import errno
import json
import os
import stat
from pathlib import Path

import pytest

from daemon.cli.output import write_json
from daemon.errors import LogIOError
from daemon.jobs.batch_summary import write_summary
from identification.model_file import write_model

MODEL = {"format": "iiwa-ident/model/1"}


def test_a_pipe_gets_the_model_and_stays_a_pipe(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_model(MODEL, pipe)
        assert stat.S_ISFIFO(pipe.stat().st_mode)
        assert json.loads(os.read(reader, 10_000)) == MODEL
    finally:
        os.close(reader)


def test_a_device_that_is_full_is_named(tmp_path: Path) -> None:
    """Through a link of the test's own: nothing can come in the place of the machine's device."""
    full = tmp_path / "full"
    full.symlink_to("/dev/full")
    with pytest.raises(OSError, match="No space left") as caught:
        write_model(MODEL, full)
    assert (caught.value.errno, caught.value.filename) == (errno.ENOSPC, str(full))


def test_a_link_stays_and_its_file_is_replaced(tmp_path: Path) -> None:
    link, kept = tmp_path / "latest.json", tmp_path / "kept.json"
    kept.write_text("old")
    link.symlink_to(kept.name)
    write_model(MODEL, link)
    assert link.is_symlink()
    assert json.loads(kept.read_text()) == MODEL
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["kept.json", "latest.json"]


def test_a_page_that_does_not_fit_on_the_disk_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk takes the first bytes and refuses the rest."""
    page, table = tmp_path / "index.html", tmp_path / "summary.csv"
    write_summary("fit", [], tmp_path)
    before = page.read_bytes(), table.read_bytes()
    write_text = Path.write_text

    def full(file: Path, text: str, **options: str) -> int:
        write_text(file, text[:10], **options)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="No space left") as caught:
        write_summary("fit", [], tmp_path)
    assert caught.value.filename == str(page)
    assert (page.read_bytes(), table.read_bytes()) == before
    with pytest.raises(LogIOError, match=r"result\.json: No space left"):
        write_json(tmp_path / "result.json", {})
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["index.html", "summary.csv"]
