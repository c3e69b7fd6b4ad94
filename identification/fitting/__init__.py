"""The parts of a fit: settings, observation, choice of the drive model, sign of the torque, result.

`identification.recording_fit` puts them together; nothing else calls them. The package itself stays empty: the command
line asks for `choices` alone, which loads nothing.
"""

from __future__ import annotations

__all__: list[str] = []
