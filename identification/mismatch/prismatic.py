"""A diagnosis in the units of its joints: findings on prismatic joints speak of N, m and N s/m.

Effects are written in the words of revolute joints, which most robots have; this turns the words once, at the end.
"""

from __future__ import annotations

from dataclasses import replace

from identification.mismatch.figures import Curve
from identification.mismatch.findings import Diagnosis, Finding
from identification.robots import RobotModel
from identification.robots.joint_units import for_prismatic, in_units

ANGLES = ("phase",)
"""Parameters in rad whatever moves: of a wave, not of a joint."""
OF_THE_BASE = ("base_tilt", "base_elasticity")


def in_units_of_joints(diagnosis: Diagnosis, robot: RobotModel) -> Diagnosis:
    """The same diagnosis; what is said of a prismatic joint, or of a robot that has no other, in its units."""
    prismatic = [not revolute for revolute in robot.kinematics.revolute]
    if not any(prismatic):
        return diagnosis

    def slides(joint: int | None) -> bool:
        return all(prismatic) if joint is None else prismatic[joint - 1]

    def said(sentence: str) -> str:
        return in_units(sentence, robot.units)

    return replace(
        diagnosis,
        findings=tuple(_finding(item) if slides(item.place.joint) else item for item in diagnosis.findings),
        classes=tuple(
            replace(item, sentence=for_prismatic(item.sentence)) if slides(item.joint) else item
            for item in diagnosis.classes
        ),
        minimum_detectable=tuple(
            replace(item, unit=for_prismatic(item.unit))
            if slides(item.place.joint) and item.effect not in OF_THE_BASE
            else item
            for item in diagnosis.minimum_detectable
        ),
        data_faults=tuple(replace(item, sentence=said(item.sentence)) for item in diagnosis.data_faults),
        torque_units=robot.units,
        model_comparison=diagnosis.model_comparison and replace(diagnosis.model_comparison, torque_units=robot.units),
        curves=tuple(_curve(item) if slides(item.joint) else item for item in diagnosis.curves),
        heldout=diagnosis.heldout
        and replace(
            diagnosis.heldout,
            misfits=tuple(replace(item, sentence=said(item.sentence)) for item in diagnosis.heldout.misfits),
        ),
        remaining=said(diagnosis.remaining),
        notes=tuple(said(note) for note in diagnosis.notes),
    )


def _finding(finding: Finding) -> Finding:
    if finding.effect in OF_THE_BASE:
        return finding
    experiment = finding.separating_experiment
    return replace(
        finding,
        parameters=tuple(
            item if item.name in ANGLES else replace(item, unit=for_prismatic(item.unit)) for item in finding.parameters
        ),
        sentence=for_prismatic(finding.sentence),
        separating_experiment=None if experiment is None else for_prismatic(experiment),
        curve=None if finding.curve is None else _curve(finding.curve),
    )


def _curve(curve: Curve) -> Curve:
    return curve if curve.coordinate in ANGLES else replace(curve, unit=for_prismatic(curve.unit))
