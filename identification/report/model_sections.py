"""What a fitted model says, as sections: parameters, RMS tables, feasibility, provenance. All of it is in `model.json`,
so a report can be made from that file alone. Here: which of its numbers are shown, how rounded, in which words.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np

from identification.fitting.rms import RmsTable
from identification.report.document import Block, Facts, Heading, Paragraph, Section, Table
from identification.report.numbers import joint_heads, listed, rounded, row_of, unit_of, with_sigma

Json = Mapping[str, Any]

# A parameter whose σ is more than half of its value is not told apart from zero at the usual two σ.
LARGEST_KNOWN_SHARE = 0.5
_SHOWN_ELSEWHERE = ("inputs", "notes", "estimator", "condition_number", "torque_delay", "torque_sign")


def undetermined(model: Json) -> list[str]:
    """Names of the base parameters that these data do not tell apart from zero."""
    return [
        str(item["name"])
        for item in model.get("base_parameters", ())
        if (share := _share(item)) is None or share > LARGEST_KNOWN_SHARE
    ]


def parameter_section(model: Json) -> Section:
    """Base parameters with σ, what the data leave open, and the physical parameters of every link."""
    items = model.get("base_parameters", ())
    with_paper = any(item.get("std_equation_15") is not None for item in items)
    rows = []
    for item in items:
        value, sigma = with_sigma(item.get("value"), item.get("std"))
        share = _share(item)
        row = [str(item["name"]), value, sigma, "–" if share is None else rounded(100 * share, 2)]
        if with_paper:
            row.append(rounded(item.get("std_equation_15"), 2))
        rows.append((*row, unit_of(item.get("unit", ""))))
    head = ("parameter", "value", "σ", "σ in %", *(("σ, eq. (15)",) if with_paper else ()), "unit")
    blocks: list[Block] = [
        Paragraph(
            "Only these combinations of the links' masses, first moments and inertias show in the joint torques "
            "(base parameters). σ is one standard deviation."
        )
    ]
    open_names = undetermined(model)
    if open_names:
        blocks.append(
            Paragraph(
                f"These data do not tell {_count(open_names, 'parameter')} apart from zero (σ above half of the "
                f"value): {listed(open_names)}. A longer recording or an excitation that moves these joints more "
                "would.",
                "warning",
            )
        )
    elif items:
        blocks.append(Paragraph("Every base parameter is known to better than half of its value."))
    blocks.append(Table("Base parameters", head, tuple(rows)))
    if with_paper:
        blocks.append(
            Paragraph(
                "σ counts the noise as it was measured between periods or as the residual shows it, coloured. Equation "
                "(15) of the paper is printed beside it: it takes all residuals as white and alike, which they "
                "are not.",
                "note",
            )
        )
    how = _estimation(model.get("provenance") or {})
    blocks += [Facts(how)] if how else []
    blocks += _friction(model.get("friction", ()))
    blocks += _links(model.get("physical_parameters", ()))
    return Section("parameters", "Parameters", tuple(blocks))


def rms_section(model: Json, validation: RmsTable | None) -> Section:
    """RMS of measured minus modelled torque on fitted, held-out and unused data, in Nm and in percent of the torque."""
    rows: list[Json] = list(model.get("rms_table") or _rows_of_contract(model))
    rows += model.get("left_out") or ()
    rows += [] if validation is None else validation.to_json()
    joints = max((len(row["rms_nm"]) for row in rows), default=0)
    heads = ("", *joint_heads(joints))
    floors = _distinct_floors(rows)
    absolute = [(str(row["label"]), *row_of(row["rms_nm"]), rounded(row.get("total_nm"))) for row in rows]
    absolute += [(label, *row_of(floor), rounded(sum(x or 0.0 for x in floor))) for label, floor in floors]
    relative = [
        (str(row["label"]), *row_of(row["percent_of_rms_torque"], 2)) for row in rows if "percent_of_rms_torque" in row
    ]
    blocks: list[Block] = [
        Paragraph(
            "How far the modelled torque is from the measured one, by joint. “base” is the free fit; “physical” keeps "
            "to the rules (10b) to (10d) for masses, inertias and friction. Where a line is near the noise, there is "
            "nothing left to model."
        ),
        Table("RMS of measured minus modelled torque, Nm", (*heads, "sum"), tuple(absolute)),
    ]
    if relative:
        blocks.append(Table("The same in % of the RMS torque", heads, tuple(relative)))
    return Section("rms", "How well the model fits", tuple(blocks))


def feasibility_section(model: Json, sentence: str | None) -> Section | None:
    """Whether a robot can have these parameters, and what is proven about the feasible set. None without a certificate.

    sentence: the answer for the base parameters, where the fit has it.
    """
    certificate = model.get("certificate") or {}
    if "feasible" not in certificate:
        return None
    reference = certificate["least_squares_cost"]
    blocks: list[Block] = [] if sentence is None else [Paragraph(sentence, "lead")]
    blocks.append(
        Paragraph(
            "The physical parameters of this report satisfy every constraint of the paper: positive masses, positive "
            "definite inertias, friction that only brakes (equations 10b to 10d)."
            if certificate["feasible"]
            else "The physical parameters VIOLATE a constraint (10b to 10d); do not simulate with them.",
            "plain" if certificate["feasible"] else "warning",
        )
    )
    entries = [
        ("Price of being physical", _price(certificate["cost"], reference)),
        ("Proven necessary", f"{_price(certificate['lower_bound'], reference)} (no set that meets them is cheaper)"),
    ]
    if certificate["feasible"]:
        blocks.append(_consistency(certificate))
    starts = certificate.get("starts") or ()
    if starts:
        converged = sum(bool(start.get("converged")) for start in starts)
        entries.append(("Search", f"{converged} of {len(starts)} starts converged; the cheapest is shown"))
    blocks.append(Facts(tuple(entries)))
    return Section("feasibility", "Can a real robot have these parameters?", tuple(blocks))


def provenance_section(provenances: Sequence[tuple[str, Json]]) -> Section | None:
    """Where everything comes from, by what it belongs to ("Fit", "Diagnosis"): digests, versions, settings, seeds."""
    if not provenances:
        return None
    blocks: list[Block] = []
    for title, provenance in provenances:
        blocks.append(Heading(title))
        inputs = provenance.get("inputs") or ()
        if isinstance(inputs, Sequence) and inputs and all(isinstance(item, Mapping) for item in inputs):
            blocks.append(
                Facts(
                    tuple(
                        (
                            PurePath(str(item.get("file", item.get("path", "")))).name,
                            ", ".join(
                                f"{key} {item[key]}" for key in ("kind", "samples", "pipeline", "sha256") if key in item
                            ),
                        )
                        for item in inputs
                    )
                )
            )
        rest = {key: value for key, value in provenance.items() if key not in _SHOWN_ELSEWHERE}
        blocks.append(Facts(tuple((key.replace("_", " "), _flat(value)) for key, value in rest.items())))
        blocks += [Paragraph(str(note), "note") for note in provenance.get("notes", ())]
    return Section("provenance", "Provenance", tuple(blocks))


def _consistency(certificate: Json) -> Paragraph:
    """Whether bodies can have the inertias: more than the paper's constraints ask for."""
    value = rounded(certificate.get("smallest_pseudo_inertia_eigenvalue"), 2)
    if certificate.get("fully_consistent"):
        return Paragraph(
            "Every link is also a body that can exist: its inertia is that of a distribution of positive mass "
            f"(smallest eigenvalue of the pseudo-inertias {value})."
        )
    return Paragraph(
        f"The paper's constraints do not ask that bodies can have these inertias, and one link's inertia is that of no "
        f"distribution of positive mass (smallest eigenvalue of the pseudo-inertias {value}). `iiwa-ident fit "
        "--full-consistency` asks for that too; `iiwa-ident export` takes bodies that exist in any case.",
        "warning",
    )


def _estimation(provenance: Json) -> tuple[tuple[str, str], ...]:
    """How the parameters were estimated, and what the data say about delay and sign of the torque."""
    facts = []
    if "estimator" in provenance:
        facts.append(("Estimator", str(provenance["estimator"]).replace("_", " ")))
    if "condition_number" in provenance:
        facts.append(("Condition of the regressor", rounded(provenance["condition_number"])))
    delay = provenance.get("torque_delay")
    if delay:
        std = delay.get("std_between_joints_s", delay["common_std_s"])
        value, sigma = with_sigma(1e3 * delay["common_s"], 1e3 * std)
        facts.append(("Torque behind position", f"{value} ± {sigma} ms (friction beyond the model looks like it too)"))
    sign = provenance.get("torque_sign")
    if sign:
        facts.append(("Sign of the torque", "INVERTED" if sign.get("inverted") else "as in the inverse dynamics"))
    return tuple(facts)


def _share(item: Json) -> float | None:
    value, std = item.get("value"), item.get("std")
    if value is None or std is None or value == 0.0 or not math.isfinite(std / value):
        return None
    return float(abs(std / value))


def _count(names: Sequence[str], noun: str) -> str:
    return f"{len(names)} {noun}{'' if len(names) == 1 else 's'}"


def _price(cost: float, reference: float) -> str:
    excess = 100.0 * (cost / reference - 1.0)
    return f"{rounded(excess, 2)} % more squared error than the free fit" if excess > 1e-6 else "nothing"


def _rows_of_contract(model: Json) -> list[Json]:
    """Lines from `rms_nm` of a model file that has no table."""
    table = model.get("rms_nm") or {}
    labels = {"fit": "fit", "heldout": "held out", "fit_physical": "fit, physical"}
    return [
        {"label": label, "rms_nm": table[key], "total_nm": sum(x or 0.0 for x in table[key])}
        for key, label in labels.items()
        if table.get(key)
    ]


def _distinct_floors(rows: Sequence[Json]) -> list[tuple[str, list[float | None]]]:
    """The noise floors of the lines, each once, named after the first line's data that has it."""
    found: list[tuple[str, list[float | None]]] = []
    for row in rows:
        floor = row.get("noise_floor_nm")
        if floor and any(value is not None for value in floor) and all(floor != known for _, known in found):
            found.append((f"noise alone, {str(row['label']).rsplit(',', 1)[0]}", floor))
    return found


def _friction(items: Sequence[Json]) -> list[Block]:
    if not items:
        return []
    rows = tuple((str(item["joint"]), *row_of((item.get("viscous"), item.get("coulomb")), 4)) for item in items)
    return [Table("Friction", ("joint", "viscous, Nm s/rad", "Coulomb, Nm"), rows)]


def _links(items: Sequence[Json]) -> list[Block]:
    if not items:
        return []
    rows = []
    for item in items:
        inertia = np.asarray(item["inertia"], dtype=np.float64)
        moments = np.linalg.eigvalsh(0.5 * (inertia + inertia.T))
        rows.append((str(item["link"]), rounded(item["mass"], 4), *row_of(item["com"], 3), *row_of(moments, 3)))
    head = ("link", "mass, kg", "x, m", "y, m", "z, m", "I₁, kg m²", "I₂, kg m²", "I₃, kg m²")
    return [
        Table(
            "One set of links with this torque: mass, centre of mass, principal moments of inertia", head, tuple(rows)
        ),
        Paragraph(
            "No torque tells these numbers one by one: many sets give the same torque. This is that of program (10); "
            "for simulators `iiwa-ident export` writes another, of bodies that exist.",
            "note",
        ),
    ]


def _flat(value: Any) -> str:
    """Nested settings as one line of text."""
    if isinstance(value, Mapping):
        return "; ".join(f"{str(key).replace('_', ' ')}: {_flat(entry)}" for key, entry in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_flat(entry) for entry in value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    return "–" if value is None else str(value)
