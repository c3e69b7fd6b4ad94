"""The live view of a run: frames that the recorder broadcasts, and what watchers make of them.

Here: the frame, the recorder's broadcast, a watcher's subscription, the difference to a model, the terminal's screen
and the server for Foxglove and PlotJuggler. Not here: the 1 kHz loop, which knows nothing of it, and the commands
(`cli`).
The way: loop -> ring -> recorder -> socket in the user's private folder -> any number of watchers, which only read. A
watcher that is slow, stopped or killed costs itself frames and nobody else anything.
"""
