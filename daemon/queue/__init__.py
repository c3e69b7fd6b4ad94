"""The long-running service: jobs in a queue, and the interface that controls it."""
