"""What keeps the arm inside its limits: limits, guard, ramps, preflight. Pure functions and small state machines.

Nothing here opens a socket, a file of the operator or a clock; the loop and the daemon call it.
"""
