"""The command `investigate`: ask the arm what a recording leaves open, one motion after the other."""

from __future__ import annotations

import ipaddress
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli.acquisition import RobotOption, ToolOption, WorkspaceOption, parse_bind, tool_from
from daemon.cli.app import app
from daemon.cli.inputs import GravityOption, MountOption, installation_of
from daemon.cli.operator_actions import AddedMassOption, AfterDropOption, DoneOption, SettleOption, YesOption, mass_of
from daemon.cli.output import JsonOption, data, data_lines, message, told_in_words
from daemon.cli.progress import bar_put_away, progress_shown
from daemon.cli.protection import folder_to_write
from daemon.cli.questions import agreed
from daemon.cli.run import RobotHostOption, address_of, confirm_motion, version_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from daemon.investigate.account import Account, Motion
    from daemon.investigate.driver import FriDriver
    from daemon.motion.preparation import PreparedMotion
    from daemon.motion.tool import FastenedMass
    from identification.investigation.actions import Action
    from identification.investigation.added_mass import AddedMass
    from identification.robots import Installation


@app.command()
def investigate(
    context: typer.Context,
    given: Annotated[
        list[Path] | None,
        typer.Option("--from", help="Recording or run folder at hand; may be given repeatedly. Without: from nothing."),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            "--budget", metavar="MINUTES", min=0.0, help="Minutes of recorded motion at most; needed to begin."
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option("--out", metavar="DIR", help="Folder; one that exists is gone on with.", callback=folder_to_write),
    ] = Path("investigation"),
    bind: Annotated[str, typer.Option("--bind", help="Address and port the robot sends to.")] = "127.0.0.1:30200",
    robot_host: RobotHostOption = None,
    fri_version: Annotated[str, typer.Option("--fri-version", help="As of `run`.")] = "1.15",
    robot: RobotOption = None,
    workspace: WorkspaceOption = None,
    tool: ToolOption = None,
    mount: MountOption = None,
    gravity: GravityOption = None,
    plan_only: Annotated[
        bool, typer.Option("--plan-only", help="Design and show the next motion; move nothing.")
    ] = False,
    yes: YesOption = False,
    after_drop: AfterDropOption = False,
    added_mass: AddedMassOption = None,
    done: DoneOption = None,
    settle: SettleOption = None,
    serial: Annotated[str | None, typer.Option("--serial", help="Serial number of the arm, as of `run`.")] = None,
    start_timeout: Annotated[float, typer.Option("--start-timeout", help="Seconds to wait for the robot.")] = 30.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the search for motions.")] = 1,
    json_file: JsonOption = None,
) -> None:
    """Design, drive and diagnose the motions that settle what recordings leave open, until nothing is or time is used.

    Each motion is shown with what it will tell, and asked for. Ctrl-C brings the arm to rest; the same command goes on
    from there. Exit code 0: settled; 1: something is open, and the page says what to do.

    Example: iiwa-ident investigate --from runs/first --from runs/second --budget 4 --out question
    """
    import msgspec

    from daemon.investigate.begin import exit_code
    from daemon.investigate.loop import Investigation
    from daemon.investigate.states import State
    from daemon.investigate.story import write_story
    from daemon.motion.tool import fastened
    from daemon.runtime_folder import lock_folder
    from identification.investigation.equivalences import unasked

    host, port = parse_bind(bind)
    version = version_of(fri_version)
    simulation = ipaddress.ip_address(host).is_loopback
    if yes and not simulation:
        raise typer.BadParameter("--yes is for a fake robot on a loopback address: a real arm asks before each motion.")
    mass = mass_of(added_mass)
    stand = installation_of(gravity, mount, None)
    context.with_resource(lock_folder(out))
    account, resumed = _account_in(out, given or [], robot, None if budget is None else 60.0 * budget, seed)
    acted = _acted(done, mass, resumed=resumed)
    account = _in_its_cell(out, account, workspace, tool, stand)
    if settle:
        wanted = tuple(dict.fromkeys((*account.wanted, *(item.value for item in settle))))
        account = msgspec.structs.replace(account, wanted=wanted)
    said = None if mass is None else (mass.mass_kg, *mass.place_m)
    carried = fastened(said, account.added_mass)
    driver = _driver(account, carried, host, port, simulation, robot_host=address_of(robot_host),
                     fri_version=version, serial=serial, start_timeout_s=start_timeout)  # fmt: skip

    def ask(motion: Motion) -> bool | None:
        del motion  # the loop has told of it
        if plan_only:
            return None
        if yes or not simulation:  # a real arm asks before each rung of its ladder, in the driver
            return True
        if not sys.stdin.isatty():
            raise typer.BadParameter("the arm will move, and nobody can be asked here: add --yes or --plan-only.")
        with bar_put_away():
            return agreed("Drive it")

    if not resumed:
        account = msgspec.structs.replace(account, added_mass=carried)
    with progress_shown(lines=False) as show:
        loop = Investigation(out, account, driver, ask=ask, tell=message, progress=show)
        if resumed:
            loop.resume(after_drop=after_drop, acted=acted, added_mass=said)
        account = loop.run()
    page = write_story(out, account)
    if told_in_words(msgspec.to_builtins(account), json_file):
        data(account.sentence)
        data_lines(account.actions)
        if account.state is State.SETTLED:
            data_lines(unasked(account.wanted))
        data(f"The page to open: {page}")
    if code := exit_code(account):
        raise typer.Exit(code)


def _acted(done: str | None, mass: AddedMass | None, *, resumed: bool) -> Action | None:
    """What the operator did to the arm. Raises a usage error for two actions, and for one that nothing asked for."""
    from identification.investigation.actions import Action

    if done is None:
        return Action.ADD_MASS if mass is not None and mass.mass_kg else None
    if mass is not None:
        raise typer.BadParameter("--done and --added-mass are two actions, and one motion shows what one of them does.")
    if not resumed:
        raise typer.BadParameter("--done answers what an investigation asked for, and this one only begins.")
    return Action(done)


def _account_in(
    out: Path, given: Sequence[Path], robot: str | None, budget_s: float | None, seed: int
) -> tuple[Account, bool]:
    """The account of the investigation in a folder, a new one if it holds none, and whether it held one."""
    import msgspec

    from daemon.errors import ConfigurationError
    from daemon.investigate.account import read_account
    from daemon.investigate.begin import begun
    from daemon.queue.investigation_step import ORDER_NAME

    if (out / ORDER_NAME).is_file():
        raise ConfigurationError(
            "it is an investigation of the service, which knows the workspace and the tool of its arm; "
            f"`iiwa-ident submit-investigation --go-on {out.resolve().name}` goes on with it.",
            file=str(out),
        )
    account = read_account(out)
    if account is None:
        if budget_s is None:
            raise typer.BadParameter("--budget MINUTES says how much motion may be recorded at most.")
        return begun(given, robot, budget_s, seed), False
    if robot not in (None, account.robot):
        raise ConfigurationError(f"its investigation is of {account.robot}; --robot says {robot}.", file=str(out))
    if given:
        raise ConfigurationError(
            "it holds an investigation already; --from begins a new one: give --out another folder.", file=str(out)
        )
    return account if budget_s is None else msgspec.structs.replace(account, budget_s=budget_s), True


def _in_its_cell(
    out: Path, account: Account, workspace: Path | None, tool: str | None, stand: Installation | None
) -> Account:
    """The account, stored with the surroundings, tool and stand that hold from now on; all are read first."""
    import msgspec

    from daemon.investigate.account import save
    from daemon.investigate.cell import gone_on_with
    from daemon.motion.workspace import load_surroundings

    cell = gone_on_with(account.cell, workspace, tool, None if stand is None else stand.gravity)
    load_surroundings(account.robot, cell.workspace, tool_from(cell.tool))
    if words := cell.describe():
        message(f"Motions are held against {words}.")
    return save(out, msgspec.structs.replace(account, cell=cell))


def _driver(
    account: Account, added_mass: FastenedMass | None, host: str, port: int, simulation: bool, **settings: object
) -> FriDriver:
    from daemon.investigate.driver import FriDriver
    from identification.robots import Installation

    cell = account.cell

    def agree(motion: PreparedMotion, periods: int) -> bool:
        try:
            with bar_put_away():
                confirm_motion(motion, periods)
        except typer.Abort:
            return False
        return True

    return FriDriver(
        robot=account.robot,
        workspace=None if cell.workspace is None else Path(cell.workspace),
        tool=tool_from(cell.tool),
        added_mass=added_mass,
        installation=None if cell.gravity_m_s2 is None else Installation(cell.gravity_m_s2),
        settings={"bind_host": host, "bind_port": port, **settings},
        simulation=simulation,
        observe=lambda event: message(event.sentence),
        agree=agree,
    )
