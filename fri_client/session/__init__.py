"""The robot's side of the talk: what a message says, whether it is believed, and when the session is lost."""
