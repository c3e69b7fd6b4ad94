"""The page as a whole: one file that needs nothing else, in which no text of a file can become markup."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

from identification.fitting.rms import RmsRow, RmsTable
from identification.physical_parameters import PhysicalParameters
from identification.recording_fit import FitResult, FitSettings, fit_recordings
from identification.recordings import Finding, ImportReport, RecordingSource
from identification.report import build_document, write_report
from identification.report.document import Document, Paragraph, Section, Table
from identification.report.fit_verdict import fit_verdict
from identification.report.page import render
from identification.report.recording_section import recording_section
from identification.robots import Installation, RobotModel
from tests.identification.synthetic import fourier_motion, inverse_dynamics, recording_of

EVIL = """</td></style><script>alert("x")</script><img src=http://evil.example/x onerror=alert(1)>'"&$\\frac{"""
VOID = {"meta", "link", "img", "br", "hr", "input"}


class Page(HTMLParser):
    """Elements with their attributes, all text, and whether every element was closed in its order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture(scope="module")
def fit(iiwa14: RobotModel, table3: PhysicalParameters) -> FitResult:
    """Four periods of the paper's plant by Pinocchio, with white noise of 0.1 Nm."""
    state = fourier_motion(7, period_s=10.0, samples=2000, seed=5)
    torque = np.tile(inverse_dynamics(iiwa14, table3, *state), (4, 1))
    noise = np.random.default_rng(6).normal(scale=0.1, size=torque.shape)
    recording = recording_of(np.tile(state[0], (4, 1)), torque + noise, period_s=10.0, periods=4)
    return fit_recordings([recording], iiwa14, FitSettings(starts=1))


@pytest.fixture(scope="module")
def page(fit: FitResult, tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("page") / "report.html"
    write_report(file, fit=fit)
    return file.read_text(encoding="utf-8")


def test_page_is_well_formed_has_no_script_and_names_no_address(page: str) -> None:
    parsed = Page(page)
    assert parsed.open == []
    assert page.startswith("<!DOCTYPE html>")
    assert parsed.of("script") == []
    assert "http:" not in page
    assert "https:" not in page
    assert {(item.get("href") or "")[:1] for _, item in parsed.elements if "href" in item} <= {"#", "d"}
    assert not [item for _, item in parsed.elements if "src" in item]


def test_every_name_is_there_once_and_every_reference_has_its_target(page: str) -> None:
    parsed = Page(page)
    names = [item["id"] for _, item in parsed.elements if "id" in item]
    assert len(names) == len(set(names))
    referred = {href[1:] for _, item in parsed.elements if (href := item.get("href") or "").startswith("#")}
    referred |= {label for _, item in parsed.elements if (label := item.get("aria-labelledby"))}
    assert referred <= set(names)


def test_a_reader_who_does_not_see_gets_scoped_heads_and_described_figures(page: str) -> None:
    parsed = Page(page)
    assert parsed.of("html") == [{"lang": "en"}]
    assert parsed.of("th")
    assert all(item.get("scope") in ("row", "col") for item in parsed.of("th"))
    panels = [item for _, item in parsed.elements if item.get("role") == "img"]
    # Seven joints: positions, velocities, torque, residual over time and frequency; three views of the path.
    assert len(panels) == len(parsed.of("svg")) == 5 * 7 + 3
    assert all(len(item.get("aria-label") or "") > 20 for item in panels)


def test_same_fit_gives_the_same_bytes_and_a_small_file(fit: FitResult, page: str, tmp_path: Path) -> None:
    write_report(tmp_path / "again.html", fit=fit)
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == page
    assert len(page.encode()) < 1_000_000


def test_no_text_of_a_file_becomes_markup(fit: FitResult, tmp_path: Path) -> None:
    recording = fit.recordings[0]
    source = RecordingSource(f"runs/{EVIL.replace('/', '')}.mcap", EVIL, EVIL, {"run_id": EVIL, "tool": EVIL})
    report = ImportReport(10, 9, (Finding(EVIL, 1, 1, 1, EVIL),))
    model = fit.to_model_json()
    model["robot"] = model["base_parameters"][0]["name"] = model["base_parameters"][0]["unit"] = EVIL
    model["provenance"] = {EVIL: EVIL, "notes": [EVIL], "inputs": [{"file": EVIL, "sha256": EVIL}], "estimator": EVIL}
    nothing = np.full(7, np.nan)
    write_report(
        tmp_path / "report.html",
        fit=fit,
        model=model,
        recordings=[replace(recording, source=source, report=report)],
        heldout=[replace(recording, source=source)],
        validation=RmsTable((RmsRow(EVIL, nothing, nothing, nothing),)),
        title=EVIL,
    )
    parsed = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert parsed.open == []
    assert parsed.of("script") == parsed.of("img") == []
    assert not [name for _, item in parsed.elements for name in item if name.startswith("on")]
    assert sum(EVIL in text for text in parsed.texts) >= 10


def test_a_model_alone_is_a_report_without_figures(fit: FitResult) -> None:
    document = build_document(model=fit.to_model_json())
    assert [section.name for section in document.sections] == ["rms", "parameters", "feasibility", "provenance"]


def test_the_first_sentence_says_what_is_left_beside_the_noise(fit: FitResult) -> None:
    document = build_document(fit=fit)
    # White noise and nothing else.
    sentence = r"mostly noise: ([\d.]+) to ([\d.]+) times what the noise alone would, by joint"
    found = re.search(sentence, document.verdict)
    assert found is not None
    assert [float(text) for text in found.groups()] == pytest.approx([1.0] * 2, rel=0.1)
    assert document.tone == "good"


@pytest.mark.parametrize(
    ("left", "noise", "feasible", "tone", "words"),
    [
        ([0.11, 0.10], [0.1, 0.1], True, "good", "1.0 to 1.1 times"),
        ([0.10, 0.35], [0.1, 0.07], True, "attention", "on joint 2: 0.35 Nm, 5.0 times"),
        ([0.20, 0.70], [0.1, 0.07], True, "attention", "on joints 1 and 2: 0.70 Nm on joint 2, 10 times"),
        ([0.11, 0.10], [None, None], True, "neutral", "how much of that is noise, these recordings do not tell"),
        ([0.11, 0.10], [0.1, 0.1], False, "attention", "VIOLATE"),
    ],
)
def test_the_verdict_of_a_fit_has_the_colour_of_what_it_says(
    left: list[float], noise: list[float | None], feasible: bool, tone: str, words: str
) -> None:
    model = {
        "base_parameters": [{"name": "FS_1", "value": 0.3, "std": 0.01}],
        "rms_nm": {"fit": left, "noise_floor": noise},
        "certificate": {"feasible": feasible},
    }
    text, said = fit_verdict(model)
    assert (words in text, said) == (True, tone)
    assert "1 of 1 base parameters" in text


def test_what_a_fit_warns_of_comes_first(fit: FitResult) -> None:
    model = fit.to_model_json()
    said, _ = fit_verdict(model)
    model["provenance"]["notes"] = ["Compared up to 10 Hz", "WARNING, friction of joint 2 came out below zero"]
    assert fit_verdict(model) == (f"WARNING, friction of joint 2 came out below zero. {said}", "attention")


def test_the_title_says_what_the_page_is_and_leads_to_the_other_one(fit: FitResult, tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", fit=fit, links=[("diagnosis/report.html", "The diagnosis")])
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<h1>Fit of iiwa14</h1>" in text
    assert '<a href="diagnosis/report.html">The diagnosis</a>' in text


@pytest.mark.parametrize("consistent", [True, False])
def test_no_page_says_that_bodies_are_real_and_are_not(fit: FitResult, consistent: bool) -> None:
    model = fit.to_model_json()
    model["certificate"]["fully_consistent"] = consistent
    sections = {item.name: item for item in build_document(model=model).sections}
    told = " ".join(block.text for block in sections["feasibility"].blocks if isinstance(block, Paragraph))
    links = " ".join(block.text for block in sections["parameters"].blocks if isinstance(block, Paragraph))
    # The set of program (10) need not be one of bodies: simulators are sent to the one that is.
    assert "for simulators `iiwa-ident export` writes another" in links
    assert ("a body that can exist" in told) is consistent
    assert ("no distribution of positive mass" in told) is not consistent
    assert "real bodies" not in told


@pytest.mark.parametrize(
    ("stand", "words"),
    [
        (Installation(), ""),
        (Installation((9.81, 0.0, 0.0)), "How the arm stood: gravity is (9.81, 0, 0) m/s² in the frame of the base."),
        (Installation(locked_joints=(("finger", 0.04),)), "Joints held: finger at 0.0400."),
    ],
)
def test_the_page_says_how_an_arm_stood_that_is_not_free_on_a_floor(
    fit: FitResult, stand: Installation, words: str
) -> None:
    told = recording_section(fit.recordings, (), stand)
    assert told is not None
    first = told.blocks[0]
    assert isinstance(first, Paragraph) is bool(words)
    assert not isinstance(first, Paragraph) or words in first.text


def test_unknown_parameters_are_named_first(fit: FitResult) -> None:
    model = fit.to_model_json()
    for item in model["base_parameters"]:
        item["std"] = abs(item["value"]) * (0.6 if item["name"] in ("XY_3", "FS_7") else 0.4)
    parameters = next(item for item in build_document(model=model).sections if item.name == "parameters")
    warnings = [block.text for block in parameters.blocks if getattr(block, "kind", "") == "warning"]  # type: ignore[union-attr]
    assert len(warnings) == 1
    assert "2 parameters" in warnings[0]
    assert "XY_3 and FS_7" in warnings[0]


def test_an_empty_report_says_so() -> None:
    document = build_document()
    assert document.verdict == "This report holds no fitted model."
    assert document.sections == ()


def test_a_link_leads_to_the_file_whatever_its_name() -> None:
    """Truth: RFC 3986. What stands for itself in a name is a place in a page, a query or a scheme in an address."""
    name = "javascript:a#1?b 100%\nü/report.html"
    table = Table("recordings", ("recording",), (("one",),), links=(name,))
    sections = (Section("recordings", "Recordings", (table,)),)
    page = Page(render(Document("t", "v", sections, links=((name, "other page"),))))
    addresses = [link["href"] for link in page.of("a") if link["href"] != "#recordings"]
    assert len(addresses) == 2
    for address in addresses:
        parts = urlsplit(address)
        assert (parts.scheme, parts.query, parts.fragment) == ("", "", "")
        assert unquote(parts.path) == name
