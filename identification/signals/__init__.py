"""From a Recording to what an estimator can use: motion, torque, and one linear treatment of both sides.

Here: averaging over periods, derivatives, filters, standstill, noise from period to period. Not here: reading files
(`recordings`), regressors and estimation.
"""
