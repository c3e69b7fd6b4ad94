"""Ask the arm: record, diagnose, choose the motion that settles what is open, check it, ask, record again.

From the bottom up: `states` (the table of the loop), `account` (what is known, on disk), `loop` (the loop itself, which
drives through a `Driver`), `driver` (over FRI, through every guard there is), `story` (the page).
"""
