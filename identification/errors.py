"""The errors of `identification`: one small tree, each with the exit code its command ends with.

    IdentificationError                    70  root; never raised itself
    ├── RobotError                         65  a robot description that cannot be used
    │   └── RobotNotFoundError             66  no such file or built-in name
    ├── RecordingError                     65  a recording that cannot be used
    │   └── RecordingNotFoundError         66  no such recording
    ├── TrajectoryError                    65  a trajectory file that cannot be used
    │   └── TrajectoryNotFoundError        66  no such trajectory
    ├── ModelFileError                     65  a model.json that cannot be used
    │   ├── ModelFileNotFoundError         66  no such model file
    │   └── InconsistentParametersError    65  parameters that no body can have; names link and slack
    ├── ExportCheckError                   70  a written simulator model that says something else when read back
    ├── SimulationError                     1  a simulation that did not stay finite
    ├── DesignError                         1  no trajectory meets what was asked for
    └── EstimationError                    65  data from which the parameters cannot be computed
        ├── UndeterminedParametersError    65  the motion leaves parameters undetermined; names them
        └── SolverError                    70  an optimiser ended without a usable answer

No logic lives here. Everything in the package raises from this tree; `daemon` turns `exit_code` into the exit status.
"""

from __future__ import annotations

from pathlib import Path
from typing import Self


def reason_of(error: Exception) -> str:
    """Why something could not be read, in words: one of the operating system without its number and path."""
    return error.strerror if isinstance(error, OSError) and error.strerror else str(error)


class IdentificationError(Exception):
    """Root of the tree. `exit_code` is the exit status of a command that ends with this error."""

    exit_code: int = 70


class FileRelatedError(IdentificationError):
    """An error about one file: `file`, `field` (column or element) and `joint` (from 1), each None where unknown."""

    exit_code = 65

    def __init__(
        self, message: str, *, file: str | Path | None = None, field: str | None = None, joint: int | None = None
    ) -> None:
        super().__init__(message)
        self.file = None if file is None else Path(file)
        self.field = field
        self.joint = joint

    @classmethod
    def at(cls, file: str | Path, message: str, *, field: str | None = None, joint: int | None = None) -> Self:
        """The error of a file, its message opening with the file's path."""
        return cls(f"{file}: {message}", file=file, field=field, joint=joint)

    @classmethod
    def named(cls, file: str | Path, message: str, *, field: str | None = None, joint: int | None = None) -> Self:
        """The error of a file, its message opening with the file's name."""
        return cls(f"{Path(file).name}: {message}", file=file, field=field, joint=joint)


class RobotError(FileRelatedError):
    """A robot description that cannot be used."""


class RobotNotFoundError(RobotError):
    """Neither a built-in robot nor an existing file."""

    exit_code = 66


class RecordingError(FileRelatedError):
    """A recording that cannot be used."""


class RecordingNotFoundError(RecordingError):
    """The recording does not exist."""

    exit_code = 66


class TrajectoryError(FileRelatedError):
    """A trajectory file that cannot be used."""


class TrajectoryNotFoundError(TrajectoryError):
    """The trajectory file does not exist."""

    exit_code = 66


class ModelFileError(FileRelatedError):
    """A model.json that cannot be used."""


class ModelFileNotFoundError(ModelFileError):
    """The model file does not exist."""

    exit_code = 66


class InconsistentParametersError(ModelFileError):
    """A link's parameters belong to no body: `link` (from 1) and `slack`, by how much, kg m² (kg for a mass)."""

    def __init__(self, message: str, *, link: int, slack: float, file: str | Path | None = None) -> None:
        super().__init__(message, file=file, field="physical_parameters")
        self.link = link
        self.slack = slack


class ExportCheckError(IdentificationError):
    """A simulator model just written gives other torques when it is read back; `file`, `program`, `difference_nm`."""

    def __init__(self, message: str, *, file: str | Path, program: str, difference_nm: float) -> None:
        super().__init__(message)
        self.file = Path(file)
        self.program = program
        self.difference_nm = difference_nm


class SimulationError(IdentificationError):
    """A forward simulation left the finite numbers at `time_s`, in `joint` (from 1)."""

    exit_code = 1

    def __init__(self, message: str, *, time_s: float, joint: int) -> None:
        super().__init__(message)
        self.time_s = time_s
        self.joint = joint


class DesignError(IdentificationError):
    """No trajectory was found that meets the limits and the budget."""

    exit_code = 1


class EstimationError(IdentificationError):
    """The data do not allow the parameters to be computed."""

    exit_code = 65


class UndeterminedParametersError(EstimationError):
    """The observation matrix has fewer independent columns than parameters.

    parameters: names that the motion cannot tell apart from the others; rank, size: numbers of independent columns
    and of parameters. advice: what helps, where whoever raises it knows more of the motion than the names say.
    """

    def __init__(self, parameters: tuple[str, ...], rank: int, size: int, advice: str = "") -> None:
        ways = (("OFF_", "--offset no"), ("IA_", "--rotor-inertia no"))
        out = " and ".join(way for symbol, way in ways if any(name.startswith(symbol) for name in parameters))
        shown = ", ".join(parameters[:12]) + (f" and {len(parameters) - 12} more" if len(parameters) > 12 else "")
        usual = f"Record a richer excitation or leave these parameters out{f' ({out})' if out else ''}."
        super().__init__(
            f"The recorded motion determines only {rank} of {size} parameters; it leaves undetermined: {shown}. "
            f"{advice or usual}"
        )
        self.parameters = parameters
        self.rank = rank
        self.size = size


class SolverError(EstimationError):
    """An optimiser ended without a usable answer: `solver`, and its own `status` word."""

    exit_code = 70

    def __init__(self, message: str, *, solver: str, status: str) -> None:
        super().__init__(message)
        self.solver = solver
        self.status = status
