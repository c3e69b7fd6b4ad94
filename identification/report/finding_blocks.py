"""One finding of a diagnosis as blocks: its sentence, its doubts, its size, and its figures before and after."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from identification.arrays import FloatArray
from identification.mismatch.effects.base import Place
from identification.mismatch.figures import Curve, TimeSeries
from identification.mismatch.findings import Diagnosis, Finding
from identification.report.document import Block, Facts, Figure, Heading, Line, Panel, Paragraph, Style, Table
from identification.report.motion_sections import spectrum_panel
from identification.report.numbers import chance, listed, rounded, unit_of, with_sigma

_STRETCHES = 150
_COMPARABLE = 4.0
_AXES = {"phase": "phase of the wave", "travel": "travel since the reversal"}


def finding_blocks(number: int, finding: Finding, diagnosis: Diagnosis) -> list[Block]:
    """The finding's part of its section; number: from 1, diagnosis: whose spectra and held-out residuals are drawn."""
    name = f"{effect_name(finding.effect)}, {place_name(finding.place)}"
    blocks: list[Block] = [Heading(f"{number}. {name[:1].upper()}{name[1:]}"), Paragraph(finding.sentence, "lead")]
    if finding.confirmed is False:
        blocks.append(Paragraph("The held-out recording does not support it.", "warning"))
    if finding.alternatives:
        others = listed([f"{effect_name(other.effect)} ({_joint(other.joint)})" for other in finding.alternatives])
        experiment = f" To tell them apart: {finding.separating_experiment}" if finding.separating_experiment else ""
        blocks.append(Paragraph(f"These data cannot tell it from: {others}.{experiment}", "warning"))
    if finding.parameters:
        rows = tuple(
            (effect_name(item.name), *with_sigma(item.value, item.std), unit_of(item.unit))
            for item in finding.parameters
        )
        blocks.append(Table("Size", ("parameter", "value", "σ", "unit"), rows))
    figure = _finding_figure(finding, diagnosis)
    if figure is not None:
        blocks.append(figure)
    blocks.append(Facts(tuple(_finding_facts(finding))))
    return blocks


def claim(finding: Finding) -> str:
    """Effect and place in brackets, with the doubt that the held-out recording leaves."""
    doubt = ", not supported by the held-out recording" if finding.confirmed is False else ""
    return f"{effect_name(finding.effect)} ({place_name(finding.place)}{doubt})"


def effect_name(name: str) -> str:
    """A name of contract §7, or of a parameter, in words."""
    return name.replace("_", " ")


def place_name(place: Place) -> str:
    """Where an effect sits: the joint, else the link, else the whole arm."""
    if place.joint is not None:
        return f"joint {place.joint}" + (f" with joint {place.other_joint}" if place.other_joint is not None else "")
    return f"link {place.link}" if place.link is not None else "the whole arm"


def curve_panel(curve: Curve, title: str, effect: bool = False) -> Panel:
    """Residual over a coordinate with the noise of each mean; effect: also without the effect, and its own torque."""
    lines = [Line("after", curve.centre, curve.after, curve.std, "dots")]
    if effect:
        lines.insert(0, Line("before", curve.centre, curve.before, curve.std, "dots"))
    if curve.fitted is not None and _fitted_shown(curve):
        lines.append(Line("fitted", curve.centre, curve.fitted))
    unit = f" ({curve.unit})" if curve.unit else ""
    axis = f"{_AXES.get(curve.coordinate, curve.coordinate)}{unit}"
    before, after = _rms(curve.before), _rms(curve.after)
    said = f"RMS of the curve {rounded(before, 2)} Nm before, {rounded(after, 2)} Nm after" if effect else ""
    return Panel(
        title, axis, "torque (Nm)", tuple(lines), said or f"RMS {rounded(after, 2)} Nm"
    )  # fmt: skip


def _finding_facts(finding: Finding) -> Iterable[tuple[str, str]]:
    confirmed = {True: "yes", False: "no", None: "not checked: no held-out recording"}
    yield "Confirmed on held-out data", confirmed[finding.confirmed]
    if finding.heldout_gain_nm.size:
        best = int(np.nanargmax(np.abs(finding.heldout_gain_nm)))
        gain = float(finding.heldout_gain_nm[best])
        yield "Held-out RMS", f"{'falls' if gain >= 0 else 'RISES'} by {rounded(abs(gain), 2)} Nm on joint {best + 1}"
    if math.isfinite(finding.share_removed):
        share = "all" if finding.share_removed >= 1.0 else f"{rounded(100 * finding.share_removed, 2)} %"
        yield "Explains", f"{share} of the misfit's energy on its joints"
    yield "Hidden in the parameters", f"{rounded(100 * finding.absorbed_fraction)} % of it, had it not been modelled"
    yield "Chance of this by noise alone", chance(finding.significance)
    yield "Score", f"{rounded(finding.score)} (log-likelihood)"
    yield from _where(finding.where)


def _where(where: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    """Joints, frequencies, times and state at which an effect shows most."""
    if where.get("joints"):
        yield "Shows on joint", listed([str(joint) for joint in where["joints"]])
    times = f"At times in {where['times_in']}" if "times_in" in where else "At times"
    for key, title, unit in (("bands_hz", "At frequencies", "Hz"), ("time_windows_s", times, "s")):
        if where.get(key):
            yield title, ", ".join(f"{low:.4g} … {high:.4g} {unit}" for low, high in where[key])
    state = where.get("state") or {}
    if state.get("from") is not None:
        span = f"{rounded(state['from'])} … {rounded(state['to'])} {state['unit']}"
        yield "Strongest at", f"{state['coordinate']} {span}"
    if where.get("periods"):
        yield "In periods", ", ".join(str(period) for period in where["periods"])


def _finding_figure(finding: Finding, diagnosis: Diagnosis) -> Figure | None:
    """Residual before and after over the effect's own coordinate, and the spectrum of the joint it shows on."""
    panels: list[Panel] = []
    joint = finding.curve.joint if finding.curve is not None else finding.place.joint
    legend: list[tuple[Style, str]] = [("before", "without the effect"), ("after", "with it")]
    if finding.curve is not None:
        panels.append(curve_panel(finding.curve, f"Joint {finding.curve.joint} over {finding.curve.coordinate}", True))
        if _fitted_shown(finding.curve):
            legend.append(("fitted", "the effect as fitted"))
    if joint is not None:
        for spectrum in diagnosis.spectra[:1]:
            lines: list[tuple[Style, FloatArray]] = [("before", spectrum.before), ("after", spectrum.after)]
            title = f"Joint {joint} over frequency"
            noise = spectrum.noise if diagnosis.baseline.noise_is_measured else None
            panels.append(spectrum_panel(joint - 1, spectrum.frequency, lines, noise, title))
            if noise is not None:
                legend.append(("noise", "noise"))
        panels += [_heldout_panel(series, joint) for series in diagnosis.heldout_series[:1]]
    if not panels:
        return None
    return Figure("Measured minus modelled torque without and with this effect", tuple(panels), tuple(legend))


def _heldout_panel(series: TimeSeries, joint: int) -> Panel:
    """Residuals of a joint (from 1) over time, as means of short stretches: their shape then shows above the noise."""
    edges = np.linspace(0, len(series.time), min(_STRETCHES, len(series.time)) + 1).astype(int)[:-1]
    counts = np.diff(np.append(edges, len(series.time)))
    time, before, after = (
        np.add.reduceat(values, edges) / counts
        for values in (series.time, series.before[:, joint - 1], series.after[:, joint - 1])
    )
    length = float(series.time[-1] - series.time[0]) / len(edges)
    return Panel(
        f"Joint {joint}, held-out (means of {rounded(1e3 * length, 2)} ms)",
        "time (s)",
        "torque (Nm)",
        (Line("before", time, before), Line("after", time, after)),
        f"residual over time on a recording that was not fitted; RMS {rounded(_rms(before), 2)} Nm without the "
        f"effects, {rounded(_rms(after), 2)} Nm with them",
    )


def _fitted_shown(curve: Curve) -> bool:
    """Whether the effect's own torque fits beside the residual: the part that base parameters take up can dwarf it."""
    if curve.fitted is None:
        return False
    own, before = (np.max(np.abs(np.nan_to_num(values)), initial=0.0) for values in (curve.fitted, curve.before))
    return bool(own <= _COMPARABLE * before)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else math.nan


def _joint(joint: int | None) -> str:
    return "the whole arm" if joint is None else f"joint {joint}"
