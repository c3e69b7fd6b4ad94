"""Joint limits and shipped trajectories, read through `importlib.resources`; numbers only."""
