"""What a joint's torque depends on beyond the model, named or not: sentences, curves with bands, errors."""

from __future__ import annotations

from identification.mismatch.findings import Diagnosis
from identification.mismatch.unknown.claims import AngleCurve, ClassClaim
from identification.report.document import Block, Figure, Line, Panel, Paragraph, Section, Table
from identification.report.numbers import joint_heads, row_of


def class_section(diagnosis: Diagnosis) -> Section | None:
    """The classes of a diagnosis; None where none is claimed."""
    claims, model = diagnosis.classes, diagnosis.class_model
    if not claims or model is None:
        return None
    blocks: list[Block] = [
        Paragraph(
            "A class says what a torque depends on and leaves its form open; a name above says which physics has that "
            "form. Nats are log-likelihood: 8 are odds of 3000 to 1.",
            "note",
        ),
        *(Paragraph(f"{claim.sentence} ({claim.significance:.0f} nats)") for claim in claims),
    ]
    panels = tuple(panel for panel in map(_panel, claims) if panel is not None)
    if panels:
        caption = "Torque, or an angle's error, over what it depends on, within the fitted range"
        blocks.append(Figure(caption, panels, (("fitted", "torque of the class ± one deviation"),)))
    rows = [
        ("fitted, nominal model", *row_of(model.fit_before_nm)),
        ("fitted, with the classes", *row_of(model.fit_after_nm)),
    ]
    if model.heldout_before_nm.size:
        rows += [
            ("not fitted, nominal model", *row_of(model.heldout_before_nm)),
            ("not fitted, with the classes", *row_of(model.heldout_after_nm)),
        ]
    head = ("", *joint_heads(model.fit_before_nm.size))
    caption = "RMS of measured minus modelled torque by joint, compared band, no name used, Nm"
    blocks.append(Table(caption, head, tuple(rows)))
    return Section("classes", "What the rest depends on, whatever its form", tuple(blocks))


def _panel(claim: ClassClaim) -> Panel | None:
    curve = claim.curve
    if curve is None:
        return None
    words = claim.name.replace("_", " ")
    if isinstance(curve, AngleCurve):
        mean, std, unit, what, title = curve.mean_rad, curve.std_rad, "rad", "angle", f"{words}, its angle"
        axis = "true minus measured angle (rad)"
    else:
        mean, std, unit, what, title = curve.mean_nm, curve.std_nm, "Nm", "torque of the class", words
        axis = "torque (Nm)"
    return Panel(
        f"Joint {claim.joint}: {title}",
        f"{curve.coordinate} ({curve.unit})",
        axis,
        (Line("fitted", curve.place, mean, std),),
        f"{what} over {curve.coordinate}, from {mean.min():.2g} to {mean.max():.2g} {unit}",
    )
