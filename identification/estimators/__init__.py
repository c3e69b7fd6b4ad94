"""Estimators: from an observation (8) to base parameters with σ, and to physical parameters that can exist.

`observation` reads the tall matrix once; `least_squares` solves (9); `semidefinite` finds the best physically
consistent parameters with a certificate; `constrained` solves the paper's program (10); `prior` settles what the data
leave open. The fit ties them together.
"""
