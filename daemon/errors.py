"""Every error the daemon raises, as one small tree; the command line turns `exit_code` into the process' exit code.

    DaemonError                     70  something in here is wrong
    ├── ConfigurationError          78  a configuration file or a run request that cannot be used
    ├── MissingInputError           66  a file that should be there is not
    ├── BadLogError                 65  a log (MCAP) that cannot be used
    ├── LogIOError                  74  the disk refused: full, read-only, gone
    ├── FolderGoneError             74  the folder of a run was moved or removed before its loop could begin
    ├── LadderError                  1  an amplitude whose turn on this arm has not come
    ├── PortInUseError              69  another program holds the UDP port
    ├── RobotUnreachableError       69  no monitoring message arrived in time
    ├── NothingToStopError          69  neither a service nor a run of this user is on the port that is to be stopped
    ├── ProtocolMismatchError       76  datagrams arrive, but of another FRI version
    ├── ChildProcessFailedError     70  loop or recorder process could not be started or died before the motion
    ├── ProofProcessError           70  a process of the proof died before the last case
    └── SealBrokenError             70  an opened label is not the one that was sealed

A stop of the motion is not an error: it is a `RunOutcome` with exit code 1 and a partial recording.
"""

from __future__ import annotations

import math

EXIT_INTERNAL = 70
EXIT_INPUT_OUTPUT = 74
EXIT_MISSING_INPUT = 66
EXIT_CONFIGURATION = 78
EXIT_INTERRUPTED = 130


def exit_code_of(error: BaseException) -> int:
    """The contract's exit code of an error: its own `exit_code`, or the nearest one for errors of the system."""
    code = getattr(error, "exit_code", None)
    if isinstance(code, int):
        return code
    if isinstance(error, FileNotFoundError):
        return EXIT_MISSING_INPUT
    if isinstance(error, UnicodeEncodeError):
        return EXIT_CONFIGURATION
    return EXIT_INPUT_OUTPUT if isinstance(error, OSError | MemoryError) else EXIT_INTERNAL


def sentence_of(error: Exception) -> str:
    """What an error says to an operator; one of the operating system names its file and gives no number."""
    if isinstance(error, UnicodeEncodeError):
        # The only such text are names of files as Linux has them; results name files in JSON, which is UTF-8.
        around = error.object[max(0, error.start - 60) : error.end + 20]
        if _is_utf8(error.object):
            return (
                f"'{around}' is a name in UTF-8, and the locale of this terminal is another: "
                "give the same command behind LC_ALL=C.UTF-8."
            )
        return f"'{around}' is no UTF-8 text, and no result can name it: give that file or folder another name."
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}." if error.filename is not None else f"{error.strerror}."
    if isinstance(error, MemoryError):
        return f"There is not enough memory for this ({str(error).rstrip('.') or 'no more is given'})."
    return str(error) or type(error).__name__


def _is_utf8(name: str) -> bool:
    """Whether the bytes of a name as Linux has them are UTF-8, however Python was told to read them."""
    try:
        name.encode("utf-8", "surrogateescape").decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


class DaemonError(Exception):
    """Root of the tree; the text is one sentence an operator can act on."""

    exit_code: int = 70


class ConfigurationError(DaemonError):
    """A configuration that cannot be used. Carries file and field."""

    exit_code = 78

    def __init__(self, reason: str, *, file: str | None = None, field: str | None = None) -> None:
        self.file = file
        self.field = field
        self.reason = reason
        where = " ".join(part for part in (file or "", f"field {field}" if field else "") if part)
        super().__init__(f"{where}: {reason}" if where else reason)


class MissingInputError(DaemonError):
    """A file or folder that is not there. Carries its path."""

    exit_code = 66

    def __init__(self, file: str, purpose: str) -> None:
        self.file = file
        self.purpose = purpose
        super().__init__(f"{file} does not exist; it is needed as {purpose}.")


class BadLogError(DaemonError):
    """A log that holds nothing usable. Carries its path."""

    exit_code = 65

    def __init__(self, file: str, reason: str) -> None:
        self.file = file
        self.reason = reason
        super().__init__(f"{file}: {reason}")


class LogIOError(DaemonError):
    """The operating system refused to read or write. Carries path and errno."""

    exit_code = 74

    def __init__(self, file: str, error: OSError) -> None:
        self.file = file
        self.errno = error.errno
        super().__init__(f"{file}: {error.strerror or error}.")

    @classmethod
    def said(cls, sentence: str) -> LogIOError:
        """What another process said of the same, in its own words."""
        error = cls("", OSError())
        error.args = (sentence,)
        return error


class FolderGoneError(DaemonError):
    """The folder of a run is not there any more, and nothing has moved yet. Carries its path."""

    exit_code = 74

    def __init__(self, folder: str) -> None:
        self.folder = folder
        super().__init__(
            f"{folder} was moved or removed before the robot was listened to; nothing was moved by this run. Give the "
            "same command again."
        )


class LadderError(DaemonError):
    """An amplitude was asked for before the smaller ones were completed. Carries arm, amplitude, done and allowed."""

    exit_code = 1

    def __init__(self, arm: str, amplitude: float, done: float, allowed: float) -> None:
        self.arm = arm
        self.amplitude = amplitude
        self.done = done
        self.allowed = allowed
        so_far = f"only {done:g} was completed so far" if done else "nothing was completed yet"
        super().__init__(
            f"Amplitude {amplitude:g} has to wait: {so_far} with this trajectory in this workspace on this arm "
            f"({arm}). Run --amplitude {allowed:g} first."
        )


class TooFastForT1Error(DaemonError):
    """The first motion on an arm is faster than T1 allows. Carries speed and limit, m/s, and the amplitude to try."""

    exit_code = 1

    def __init__(self, amplitude: float, speed_m_s: float, limit_m_s: float) -> None:
        self.speed_m_s = speed_m_s
        self.limit_m_s = limit_m_s
        self.allowed = math.floor(1e3 * amplitude * limit_m_s / speed_m_s) * 1e-3
        super().__init__(
            f"At amplitude {amplitude:g} the end-effector reaches {speed_m_s:.3f} m/s; the first run of a motion on an "
            f"arm is driven in T1, which allows {limit_m_s:g} m/s. Run --amplitude {self.allowed:g} first."
        )


class PortInUseError(DaemonError):
    """Another program holds the UDP port. Carries host, port and, where it is one of ours, the holder's process id."""

    exit_code = 69

    def __init__(self, host: str, port: int, *, holder_pid: int | None = None) -> None:
        self.host = host
        self.port = port
        self.holder_pid = holder_pid
        holder = "another program" if holder_pid is None else f"another iiwa-ident (process {holder_pid})"
        super().__init__(
            f"UDP port {port} on {host} is in use by {holder}: stop that program or choose another port "
            "(--bind, or fri.bind_port in a configuration), and set the same port in the robot's FRI configuration."
        )


class RobotUnreachableError(DaemonError):
    """No monitoring message within the time allowed. Carries address and seconds waited."""

    exit_code = 69

    def __init__(self, host: str, port: int, waited_s: float) -> None:
        self.host = host
        self.port = port
        self.waited_s = waited_s
        super().__init__(
            f"No FRI message arrived on {host}:{port} within {waited_s:g} s: "
            "start the FRI application on the robot and check the address it sends to (`iiwa-ident doctor`)."
        )


class NothingToStopError(DaemonError):
    """No service and no run of this user is on the UDP port, or on any (None). Carries it, and the ports in use."""

    exit_code = 69

    def __init__(self, port: int | None, others: list[int]) -> None:
        self.port = port
        self.others = others
        on = ", ".join(map(str, others))
        where = "any UDP port" if port is None else f"UDP port {port}"
        elsewhere = f" There is one on {on}: say --port." if others else ""
        super().__init__(
            f"Nothing was stopped: no service and no run of this user is on {where}."
            f"{elsewhere} Where an arm moves all the same, press Ctrl-C where it was started, or the emergency stop."
        )


class ProtocolMismatchError(DaemonError):
    """Datagrams arrive that are not of the FRI version asked for. Carries that version."""

    exit_code = 76

    def __init__(self, fri_version: str, reason: str) -> None:
        self.fri_version = fri_version
        self.reason = reason
        super().__init__(reason)


class ChildProcessFailedError(DaemonError):
    """The loop or the recorder process failed before anything moved. Carries its role, return code and last words."""

    def __init__(self, role: str, return_code: int | None, last_words: str) -> None:
        self.role = role
        self.return_code = return_code
        self.last_words = last_words
        tail = last_words.strip().splitlines()[-1] if last_words.strip() else "it said nothing"
        super().__init__(f"The {role} process ended before the run began (return code {return_code}): {tail}")


class ProofProcessError(DaemonError):
    """A process that draws or diagnoses concealed cases has ended early. Carries its command and return code."""

    def __init__(self, command: str, return_code: int) -> None:
        self.command = command
        self.return_code = return_code
        super().__init__(
            f"'python {command}' ended before the last case (code {return_code}); its last messages say why."
        )


class SealBrokenError(DaemonError):
    """A label that does not hash to what was published before the diagnosis. Carries the case's name."""

    def __init__(self, case: str) -> None:
        self.case = case
        super().__init__(f"case {case}: the opened label is not the one whose hash was published; the proof is void.")
