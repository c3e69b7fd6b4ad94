"""Which of the effects that were found may be named, and where they are seen."""
