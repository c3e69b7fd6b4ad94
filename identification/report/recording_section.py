"""What was recorded, with what, and what the reading of each file found."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from identification.recordings.recording import Recording
from identification.report.document import Block, Facts, Heading, Paragraph, Section
from identification.report.link import link_facts, link_sentence, read_loop_report
from identification.report.numbers import rounded
from identification.robots.installation import ON_THE_FLOOR, Installation

_METADATA = (
    ("run_id", "Run"),
    ("date", "Recorded"),
    ("serial", "Arm, serial number"),
    ("fri_version", "FRI version"),
    ("tool", "Tool"),
    ("tool_mass_kg", "Tool's mass in kg"),
    ("tool_center_of_mass_m", "Tool's centre of mass in m"),
    ("tool_inertia_kg_m2", "Tool's inertia in kg m²"),
    ("amplitude", "Amplitude"),
    ("seed", "Seed"),
    ("software_version", "Recorded with version"),
)


def recording_section(
    recordings: Sequence[Recording], heldout: Sequence[Recording], stand: Installation = ON_THE_FLOOR
) -> Section | None:
    """One part per recording, the held-out ones last and named as such; None without recordings.

    stand: how the arm stood as the results count it; said where that is not free on a floor.
    """
    if not recordings and not heldout:
        return None
    blocks: list[Block] = []
    if stand != ON_THE_FLOOR:
        gravity = ", ".join(rounded(value) for value in stand.gravity)
        held = ", ".join(f"{name} at {rounded(place)}" for name, place in stand.locked_joints)
        held = f" Joints held: {held}." if held else ""
        blocks.append(Paragraph(f"How the arm stood: gravity is ({gravity}) m/s² in the frame of the base.{held}"))
    for recording in recordings:
        blocks += _part(recording, "")
    for recording in heldout:
        blocks += _part(recording, " (held out: not fitted)")
    return Section("recordings", "What was recorded", tuple(blocks))


def _part(recording: Recording, role: str) -> list[Block]:
    path = Path(recording.source.path)
    # With its folder: the logs of all runs have one name.
    blocks: list[Block] = [Heading("/".join(path.parts[-2:]) + role)]
    report = read_loop_report(path)
    if report is not None:
        clean = not any(report.get(name) for name in ("missing", "lost_in_handover", "refused", "undecodable"))
        blocks.append(Paragraph(link_sentence(report), "plain" if clean else "warning"))
    blocks += [Paragraph(f"{finding.sentence}.".replace("..", "."), "warning") for finding in recording.report.findings]
    facts = [
        ("Samples", f"{recording.samples} of {recording.n} joints in {rounded(recording.duration_s, 4)} s"),
        ("Sampling", f"every {rounded(1e3 * recording.sampling_period_s)} ms"),
    ]
    if recording.is_periodic and recording.period_s is not None:
        facts.append(("Periods", f"{recording.complete_periods} of {rounded(recording.period_s, 4)} s"))
    else:
        facts.append(("Periods", "none: noise cannot be told from repetition"))
    read = recording.report
    if read.rows_kept != read.rows_read:
        facts.append(("Rows", f"{read.rows_kept} of {read.rows_read} used"))
    metadata = recording.source.metadata
    facts += [(title, metadata[key]) for key, title in _METADATA if metadata.get(key)]
    facts += [] if report is None else link_facts(report)
    facts.append(("SHA-256", recording.source.sha256))
    return [*blocks, Facts(tuple(facts))]
