"""What a joint's torque depends on where no form is known: classes of dependence, one Gaussian model, one evidence.

Reading order: `functions`, `inputs`, `classes`; `evidence` (the model and its log evidence), `rows` (what it is given),
`selection` (which classes stand); `claims`, `judgement` (what is said),
`named` (names against classes).
"""
