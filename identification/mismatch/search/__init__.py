"""Which effects of the library explain the mean of the periods: screening, refinement, sets fitted together."""
