"""An adversary of the 1 kHz loop in simulated time; the only oracle is the judge at the robot's side."""
