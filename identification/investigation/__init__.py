"""What to record next: hypotheses that recordings leave open, motions that tell them apart, and what no motion can.

From the bottom up: `columns` (rows of hypotheses as normal equations, recorded and planned), `hypotheses` (which are
alive, and how likely), `experiments` (motions a robot can be asked for), `separation` and `forecast` (what a motion
would tell), `equivalences` (what none tells, and what to do instead), `choice` (the motion to drive). No robot is moved
from here, no clock is read.
"""
