"""What the loop hands to other processes: the ring in shared memory, its records, and what is read back from it."""
