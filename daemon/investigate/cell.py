"""What an investigation was told of its arm: surroundings, tool and stand, kept in the account from command to command.

Here: the value, and what becomes of it when the command is given again. Not here: what the files say
(`daemon.motion`), and the options themselves (`daemon.cli.investigate`).
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import msgspec

from daemon.errors import ConfigurationError
from daemon.json_files import read_bytes

Vector = tuple[float, float, float]


class Cell(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """workspace: file of `--workspace`; tool: words or file of `--tool`; gravity_m_s2: in the frame of the base.

    What is None was never said. digests: SHA-256 of each file that is named here.
    """

    workspace: str | None = None
    tool: str | None = None
    gravity_m_s2: Vector | None = None
    digests: dict[str, str] = msgspec.field(default_factory=dict)

    def describe(self) -> str:
        """One line for the screen, empty where nothing was ever said."""
        words = [f"workspace {self.workspace}"] if self.workspace is not None else []
        words += [f"tool {self.tool}"] if self.tool is not None else []
        if self.gravity_m_s2 is not None:
            words.append(f"gravity ({', '.join(f'{value:g}' for value in self.gravity_m_s2)}) m/s²")
        return ", ".join(words)


def gone_on_with(before: Cell, workspace: Path | None, tool: str | None, gravity_m_s2: Vector | None) -> Cell:
    """What holds for a command: what it says, and what an earlier one said where it says nothing.

    Raises MissingInputError for a file that is not there, ConfigurationError for one that is not what it was when the
    motions were held against it, unless this command names it anew.
    """
    said = {} if workspace is None else {"workspace": str(workspace.absolute())}
    if tool is not None:
        said["tool"] = str(Path(tool).absolute()) if _is_file(tool) else tool
    cell = msgspec.structs.replace(before, **said, gravity_m_s2=gravity_m_s2 or before.gravity_m_s2)
    digests = {}
    for option, file in (("workspace", cell.workspace), ("tool", cell.tool)):
        if file is None or (option == "tool" and not _is_file(file)):
            continue
        digests[file] = _digest(file, option)
        if option not in said and digests[file] != before.digests.get(file):
            raise ConfigurationError(
                f"it has changed since the motions of this investigation were held against it; --{option} {file} takes "
                "it as it is now.",
                file=file,
            )
    return msgspec.structs.replace(cell, digests=digests)


def _is_file(tool: str) -> bool:
    return Path(tool).suffix.lower() in (".yaml", ".yml")


def _digest(file: str, option: str) -> str:
    return hashlib.sha256(read_bytes(file, f"the {option} of this investigation (--{option})")).hexdigest()
