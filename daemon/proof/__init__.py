"""The proof of the diagnosis: sealed cases drawn, diagnosed without their labels, scored."""
