"""A motion before it is run: tool, cell, predicted torque, room to move, picture."""
