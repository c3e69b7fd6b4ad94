"""One motion as a state machine driven by ticks: the path, its stops, and the way back onto it."""
