"""Faults of the data that look like physics: turned torques, wrong clocks, cut-off sensors."""
