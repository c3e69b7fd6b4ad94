"""What is asked of host, link and robot before a run."""
