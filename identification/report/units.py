"""A report in the units of the robot's joints: pages about prismatic joints speak of N, m and N s/m.

Sections are built in the words of revolute joints, which most robots have; this turns the words once, at the end. Cells
of tables stay: they hold numbers, or a unit of their own.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from identification.report.document import Block, Document, Facts, Heading, Panel, Paragraph, Section, Table
from identification.robots.joint_units import in_units

AS_THEY_ARE = ("provenance", "recordings")
"""Sections about files and programs."""
ANGLES = ("phase",)
"""Axes in rad whatever moves: of a wave, not of a joint."""
_JOINT = re.compile(r"\bjoint (\d+)", re.IGNORECASE)


def in_units_of_joints(document: Document, units: Sequence[str]) -> Document:
    """The same document; units: of each joint's torque, "Nm" or "N"; empty: all Nm."""
    if "N" not in units:
        return document
    sections = (item if item.name in AS_THEY_ARE else _section(item, units) for item in document.sections)
    return replace(document, verdict=in_units(document.verdict, units), sections=tuple(sections))


def _section(section: Section, units: Sequence[str]) -> Section:
    """A block that names no joint is about the one in the heading above it."""
    joints: tuple[int, ...] = ()
    blocks = []
    for block in section.blocks:
        if isinstance(block, Heading):
            joints = _joints_in(block.text)
        blocks.append(_block(block, units, joints))
    return replace(section, title=in_units(section.title, units), blocks=tuple(blocks))


def _block(block: Block, units: Sequence[str], joints: tuple[int, ...]) -> Block:
    def said(text: str) -> str:
        return in_units(text, units, joints)

    if isinstance(block, Paragraph | Heading):
        return replace(block, text=said(block.text))
    if isinstance(block, Facts):
        return Facts(tuple((said(term), said(text)) for term, text in block.entries))
    if isinstance(block, Table):
        return replace(block, caption=said(block.caption), head=tuple(map(said, block.head)))
    return replace(
        block,
        caption=said(block.caption),
        panels=tuple(_panel(panel, units, joints) for panel in block.panels),
        legend=tuple((style, said(text)) for style, text in block.legend),
    )


def _panel(panel: Panel, units: Sequence[str], joints: tuple[int, ...]) -> Panel:
    own = _joints_in(panel.title) or joints

    def said(text: str) -> str:
        return in_units(text, units, own)

    of_angle = panel.x_label.startswith(ANGLES)
    return replace(
        panel,
        title=said(panel.title),
        x_label=panel.x_label if of_angle else said(panel.x_label),
        y_label=said(panel.y_label),
        description=said(panel.description),
    )


def _joints_in(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in _JOINT.findall(text))
