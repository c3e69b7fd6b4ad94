"""The tutorial's commands on a real recording run as printed, and say the numbers that the page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from daemon.cli.app import main
from tests.daemon.test_commands_in_docs import REPOSITORY, printed

PAGE = REPOSITORY / "docs" / "tutorial.md"


def test_the_tutorial_says_what_comes_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "fixtures").symlink_to(REPOSITORY / "fixtures")
    monkeypatch.chdir(tmp_path)
    said = []
    for line in printed(PAGE):
        with pytest.raises(SystemExit) as end:
            main(line.split()[1:])
        assert end.value.code in (0, None), line
        said.append(capsys.readouterr().out)
    fit, before, diagnosis, after, *_ = said
    text = PAGE.read_text(encoding="utf-8")
    mass, sigma = re.search(r"M_1 +([\d.]+) +([\d.]+)", fit).groups()  # type: ignore[union-attr]
    assert f"{float(mass):.2f} ± {float(sigma):.2f} kg" in text
    assert re.search(r"by (-[\d.]+ ± \d+) N s/m", diagnosis).group(1).replace("-", "−") in text  # type: ignore[union-attr]
    for output in (before, after):
        newton, percent = re.findall(r"emps_b.npz, base +([\d.]+)", output)
        assert f"{float(newton):.1f} N" in text
        assert f"{float(percent):.1f} %" in text
    assert Path("emps.xml").is_file()
