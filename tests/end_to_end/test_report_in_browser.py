"""The report in a real browser: Debian's chromium without a screen. What the page needs from outside is counted by the
server that hands it out; what it complains about, by its console. Where there is no chromium the tests skip.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from identification.recording_fit import FitSettings, fit_recordings
from identification.recordings import ImportReport, Recording, RecordingSource
from identification.report import write_report
from identification.robots import load_robot

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PHONE_WIDTH = 390

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here; `apt-get install chromium` brings one")

# The page in a frame as wide as a phone; what sticks out of it on the right is named.
MEASURE = f"""<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,">
<iframe src="/report.html" style="width:{PHONE_WIDTH}px;height:800px;border:0"></iframe><pre id="out"></pre>
<script>
document.querySelector("iframe").addEventListener("load", event => {{
  const page = event.target.contentDocument, root = page.documentElement;
  const scrolls = element => element.closest(".wide") && !element.classList.contains("wide");
  const outside = [...page.body.querySelectorAll("*")].filter(
    element => element.getBoundingClientRect().right > root.clientWidth + 1 && !scrolls(element));
  document.getElementById("out").textContent = JSON.stringify({{
    width: root.clientWidth, scroll: root.scrollWidth, panels: page.querySelectorAll("svg").length,
    outside: outside.map(element => element.tagName + " " + element.className)}});
}});
</script>"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of a fit of an arm with two joints, with names that are longer than a phone is wide."""
    folder = tmp_path_factory.mktemp("report")
    urdf = folder / f"{'arm_' * 40}.urdf"
    urdf.write_text(
        '<robot name="arm"><link name="base"/><link name="upper"/><link name="lower"/>'
        '<joint name="first" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>'
        '<origin xyz="0 0 0.3"/><limit lower="-3" upper="3" velocity="2" effort="90"/></joint>'
        '<joint name="second" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="0 1 0"/>'
        '<origin xyz="0 0 0.4"/><limit lower="-3" upper="3" velocity="2" effort="50"/></joint></robot>'
    )
    generator = np.random.default_rng(7)
    time = np.arange(8000) * 0.005
    phase = 2.0 * np.pi * time / 5.0
    position = np.column_stack([np.sin(phase) + 0.3 * np.cos(3 * phase), np.cos(2 * phase) + 0.2 * np.sin(5 * phase)])
    velocity = np.gradient(position, time, axis=0)
    torque = 12.0 * np.sin(position) + 0.8 * np.sign(velocity) + 0.4 * velocity
    recording = Recording(
        time=time,
        position=position,
        torque=torque + generator.normal(scale=0.05, size=torque.shape),
        sampling_period_s=0.005,
        source=RecordingSource(str(folder / f"{'recording_' * 20}.npz"), "a" * 64, "npz"),
        report=ImportReport(8000, 8000),
        robot=str(urdf),
        period_index=np.arange(8000) // 1000,
        sample_in_period=np.arange(8000) % 1000,
        period_s=5.0,
        samples_per_period=1000,
    )
    settings = FitSettings(physical=False, check_torque_sign=False)
    write_report(folder / "report.html", fit=fit_recordings([recording], load_robot(str(urdf)), settings))
    return folder / "report.html"


@contextmanager
def served(report: Path) -> Iterator[tuple[str, list[str]]]:
    """The page and the frame around it on a free port, and the list of everything that is asked for."""
    asked: list[str] = []
    pages = {"/report.html": report.read_bytes(), "/measure.html": MEASURE.encode()}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            body = pages.get(self.path)
            self.send_response(200 if body else 404)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, format: str, *arguments: object) -> None:
            """No lines into the tests' output."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def chromium(profile: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the browser to its end, with a profile of its own and nobody to resolve a name for it."""
    assert CHROMIUM is not None
    return subprocess.run(
        [
            CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
            "--disable-background-networking", "--disable-component-update", "--disable-sync",
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "--enable-logging=stderr",
            f"--user-data-dir={profile}", "--virtual-time-budget=20000", *arguments,
        ],
        capture_output=True, text=True, timeout=600, check=True,
    )  # fmt: skip


def test_page_asks_for_nothing_complains_about_nothing_and_fits_a_phone(report: Path, tmp_path: Path) -> None:
    with served(report) as (address, asked):
        browser = chromium(tmp_path / "profile", "--dump-dom", f"{address}/measure.html")
    assert sorted(asked) == ["/measure.html", "/report.html"]
    assert [line for line in browser.stderr.splitlines() if "CONSOLE" in line] == []
    measured = re.search(r'<pre id="out">(.*?)</pre>', browser.stdout)
    assert measured is not None, "the frame was never loaded"
    found = json.loads(measured.group(1))
    # Positions, velocities, three views, torque, residuals over time and frequency.
    assert found["panels"] == 2 + 2 + 3 + 2 + 2 + 2
    assert found["width"] <= PHONE_WIDTH
    assert found["scroll"] <= found["width"]
    assert found["outside"] == []


def test_page_prints_to_several_pages_of_paper(report: Path, tmp_path: Path) -> None:
    paper = tmp_path / "report.pdf"
    chromium(tmp_path / "profile", "--no-pdf-header-footer", f"--print-to-pdf={paper}", report.as_uri())
    content = paper.read_bytes()
    assert content.startswith(b"%PDF")
    pages = re.findall(rb"/Type\s*/Page\b(?!s)", content)
    assert 2 <= len(pages) <= 12
    sheets = {
        tuple(round(float(edge)) for edge in box.split()) for box in re.findall(rb"/MediaBox\s*\[([^\]]*)", content)
    }
    assert sheets == {(0, 0, 595, 842)}, "A4 in points"
