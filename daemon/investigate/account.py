"""What an investigation knows, on disk: one JSON file, written whole after every step, from which it goes on.

Value objects and their file.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from daemon.errors import ConfigurationError, LogIOError
from daemon.folders import make_folder
from daemon.investigate.cell import Cell
from daemon.investigate.states import State
from daemon.json_files import read_json, write_json
from identification.investigation.actions import Action

FORMAT = "iiwa-ident/investigation/1"
NAME = "investigation.json"


class _Entry(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all: immutable, keywords only."""


class Alive(_Entry, frozen=True, kw_only=True):
    """One hypothesis: name in words, effect and joint as in diagnosis.json, probability, nats against nothing more."""

    name: str
    effect: str | None
    joint: int | None
    probability: float
    log_odds: float


class Motion(_Entry, frozen=True, kw_only=True):
    """A motion that was chosen. purpose: in words. tells: the pair it is to tell apart.

    forecast: probability that the truth has its name afterwards, or that nothing is there; now: the same without it;
    None where nothing is predicted (the first two motions). forms: probability that it is a form of the library; named,
    named_now: that it then has its name. seconds: of recorded motion. trajectory: file in the folder.
    """

    number: int
    kind: str
    purpose: str
    trajectory: str
    periods: int
    seconds: float
    forecast: float | None = None
    now: float | None = None
    forms: float = 1.0
    named: float | None = None
    named_now: float | None = None
    tells: tuple[str, str] | None = None


class Recorded(_Entry, frozen=True, kw_only=True):
    """A recording. motion: None for one that was given. stood_out: whether afterwards some hypothesis stood out.

    added_mass: kg and m from the flange of a known mass that was on it. action: the motion was driven again to see
    what this did.
    """

    file: str
    motion: Motion | None = None
    added_mass: tuple[float, float, float, float] | None = None
    action: Action | None = None


class Named(_Entry, frozen=True, kw_only=True):
    """One finding of the diagnosis: effect and joint, and the effects that could stand in its place."""

    effect: str
    joint: int | None
    alternatives: tuple[str, ...] = ()


class Told(_Entry, frozen=True, kw_only=True):
    """What an action of the operator told. answer: short, for programs. recording: by the recording of that number."""

    action: Action
    answer: str
    settled: bool
    sentence: str
    recording: int = 0


class Step(_Entry, frozen=True, kw_only=True):
    """What was known after so many recordings. stands_out: whether the leading hypothesis led all others.

    agreements: name, and the chance that its size differs so much between the recordings if it is one. day_terms: what
    changed between them, in words.
    """

    recordings: int
    verdict: str
    answer: str
    alive: tuple[Alive, ...]
    questions: tuple[str, ...]
    findings: tuple[Named, ...]
    stands_out: bool
    remaining: str
    agreements: tuple[tuple[str, float], ...] = ()
    day_terms: tuple[str, ...] = ()


class Account(_Entry, frozen=True, kw_only=True):
    """All of it. pending: the motion that is chosen, not recorded. attempts: folders of motions begun so far.

    confirming: motions in a row that were to add evidence where the hypotheses were told apart already.
    sentence: how it ended, or stands. exit_code: of the last motion that was not completed.
    actions: what the operator is asked to do, in words; asks: the same for programs.
    added_mass: kg and m from the flange of a known mass that is on it now. wanted: questions of the operator about what
    no motion shows, of `INVISIBLE`. doing: an action that was done and whose motion is not recorded yet. told: what
    the first `heard` of the recordings after an action told. cell: surroundings, tool and stand, where a command said.
    """

    robot: str
    seed: int
    budget_s: float
    state: State = State.DIAGNOSING
    recordings: tuple[Recorded, ...] = ()
    steps: tuple[Step, ...] = ()
    pending: Motion | None = None
    attempts: int = 0
    confirming: int = 0
    sentence: str = ""
    actions: tuple[str, ...] = ()
    asks: tuple[Action, ...] = ()
    exit_code: int = 1
    added_mass: tuple[float, float, float, float] | None = None
    wanted: tuple[str, ...] = ()
    doing: Action | None = None
    told: tuple[Told, ...] = ()
    heard: int = 0
    cell: Cell = Cell()
    format: str = FORMAT

    @property
    def used_s(self) -> float:
        """Seconds of motion that were driven and recorded."""
        return sum(item.motion.seconds for item in self.recordings if item.motion is not None)

    @property
    def left_s(self) -> float:
        """Seconds of motion left."""
        return self.budget_s - self.used_s


def read_account(folder: Path) -> Account | None:
    """The account in a folder; None where there is none. Raises ConfigurationError for one that cannot be read."""
    file = folder / NAME
    if not file.is_file():
        return None
    account = read_json(file, Account)
    if account.format != FORMAT:
        raise ConfigurationError(f"its format is '{account.format}', this version reads '{FORMAT}'.", file=str(file))
    return account


def save(folder: Path, account: Account) -> Account:
    """Write the account; the same, so that a step can end with it. Raises LogIOError."""
    try:
        make_folder(folder)
        write_json(folder / NAME, account)
    except OSError as error:
        raise LogIOError(str(folder / NAME), error) from error
    return account


def not_asked_for(action: Action | None, account: Account, folder: Path) -> ConfigurationError:
    """What is said of an action that would be judged as another one, or as nothing."""
    if account.state is State.NEEDS_ACTION and account.asks:
        options = ["--added-mass" if asked is Action.ADD_MASS else f"--done {asked}" for asked in account.asks]
        return ConfigurationError(
            f"it asks for `{'` or `'.join(options)}`, not for `--done {action}`: a motion after another action settles "
            "nothing that is open. Once the arm is as it was, do what is asked.",
            file=str(folder),
        )
    return ConfigurationError(
        f"it is {account.state.value.replace('_', ' ')}, and nothing asks for `--done {action}` now: what was done to "
        "the arm counts where the investigation needs an action or is settled. Once the arm is as it was, give "
        "the command without it.",
        file=str(folder),
    )


def without_its_mass(folder: Path) -> ConfigurationError:
    """What is said where the known mass is off before the motion that is to show what it does."""
    return ConfigurationError(
        "the next motion is to show what the known mass changes, and would be driven without one: fasten it again "
        "(--added-mass KG@X,Y,Z), or begin anew with --from and another --out.",
        file=str(folder),
    )
