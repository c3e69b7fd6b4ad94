"""What is done with recordings, apart from any robot: the detached worker, a diagnosis, a batch."""
