"""Where a model and a recording differ: locate it, name the missing physics, model it, show the fit improve.

The way of the data: recording → `Evidence` (mean, noise, rows) → between-period effects → repeatable effects → held-out
check → verdict → `diagnosis.json`. A name is a claim on held-out data; `indistinguishable` and `unexplained` are
answers too. Knows nothing of files, sockets and clocks.
"""
