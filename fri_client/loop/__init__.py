"""The 1 kHz loop: receive, decide, pass the gate, answer, hand over."""
