"""One run: the supervisor and its processes, what they record, and what is left of it in its folder."""
