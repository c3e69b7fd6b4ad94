"""A model that somebody else made, against these recordings: how much of its error is wrong parameters, how much is
missing physics, and which links are wrong.
"""

from __future__ import annotations

from identification.mismatch.baseline import ModelComparison
from identification.report.document import Block, Paragraph, Section, Table
from identification.report.numbers import chance, joint_heads, rounded, row_of, unit_of, with_sigma


def comparison_section(comparison: ModelComparison | None) -> Section | None:
    """The split of the model's error by joint, its links, and its parameters that are wrong; None without a model."""
    if comparison is None:
        return None
    rows = (
        ("left by the given model", *row_of(comparison.model_nm)),
        ("… of that, wrong parameters", *row_of(comparison.parameters_nm)),
        ("left with its parameters put right", *row_of(comparison.missing_nm)),
        ("left with the findings as well", *row_of(comparison.findings_nm)),
    )
    links = tuple(
        (str(item.link), "wrong" if item.wrong else "right within σ", rounded(item.torque_nm), chance(item.probability))
        for item in comparison.links
    )
    wrong = sorted((item for item in comparison.parameters if item.wrong), key=lambda item: -item.torque_nm)
    blocks: list[Block] = [
        *(Paragraph(sentence, "warning") for sentence in comparison.no_check),
        Paragraph(comparison.sentence, "lead"),
        Table("RMS of measured minus modelled torque by joint, Nm", ("", *joint_heads(comparison.model_nm.size)), rows),
    ]
    # With what is named in the set-up, links and parameters are off as a consequence of that.
    if links and not comparison.set_up:
        head = ("link", "parameters", "torque of the difference, Nm", "chance if right")
        blocks.append(Table("Its links", head, links))
    if wrong and not comparison.set_up:
        blocks.append(
            Table(
                "Its base parameters that these recordings refute",
                ("parameter", "link", "given", "identified", "σ", "difference in σ", "unit"),
                tuple(
                    (
                        item.name,
                        str(item.link),
                        with_sigma(item.model, item.std)[0],
                        *with_sigma(item.fitted, item.std),
                        rounded(item.sigmas, 2),
                        unit_of(item.unit),
                    )
                    for item in wrong
                ),
            )
        )
    return Section("comparison", "The given model against these recordings", tuple(blocks))
