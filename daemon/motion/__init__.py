"""A motion before it is run: tool, cell, foreseen torque, room to move, picture."""
