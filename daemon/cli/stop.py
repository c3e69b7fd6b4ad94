"""`iiwa-ident stop`: bring to rest what this user drives."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from daemon.cli.app import app
from daemon.cli.option_groups import grouped
from daemon.cli.output import JsonOption
from daemon.cli.service import USUAL_PORT, Connection, show
from daemon.errors import DaemonError, NothingToStopError
from daemon.queue import control_api as api


@app.command()
@grouped
def stop(service: Connection, json_file: JsonOption = None) -> None:
    """Ramp the arm down now and hold every waiting run. May be said at any time and as often as you like.

    Without --port and --endpoint it stops every arm that a service, a run or an investigation of this user drives.
    This is no emergency stop: where the arm does not come to rest, use the one on the robot.

    Example: iiwa-ident stop
    """
    from daemon.runtime_folder import port_holders

    reply: api.Stopped | None
    failure = None
    if service.endpoint is not None:
        reply = service.ask(api.StopMotion(), api.Stopped)
    elif service.port is not None:
        reply = _stopped(service, service.port)
    else:
        reply, failure = _all_stopped(service, sorted({USUAL_PORT, *port_holders()}))
    if reply is not None:
        show(reply, json_file, reply.sentence)
    if failure is not None:
        raise failure


def _all_stopped(service: Connection, ports: list[int]) -> tuple[api.Stopped | None, DaemonError | None]:
    """What the stops on several UDP ports did, as one answer, and the first failure of another one.

    Each is asked at once: none waits for another's silence. Raises NothingToStopError when there is nothing on any.
    """

    def attempt(port: int) -> api.Stopped | DaemonError:
        try:
            return _stopped(service, port)
        except DaemonError as error:
            return error

    with ThreadPoolExecutor(len(ports)) as pool:
        outcomes = dict(zip(ports, pool.map(attempt, ports), strict=True))
    stops = {port: each for port, each in outcomes.items() if isinstance(each, api.Stopped)}
    failures = [e for e in outcomes.values() if isinstance(e, DaemonError) and not isinstance(e, NothingToStopError)]
    failure = failures[0] if failures else None
    if not stops:
        if failure is None:
            raise NothingToStopError(None, [])
        return None, failure
    replies = list(stops.values())
    if len(replies) == 1:
        return replies[0], failure
    together = api.Stopped(
        was_moving=any(each.was_moving for each in replies),
        already=all(each.already for each in replies),
        run=next((each.run for each in replies if each.run is not None), None),
        held=sum(each.held for each in replies),
        sentence="\n".join(f"UDP port {port}: {each.sentence}" for port, each in stops.items()),
    )
    return together, failure


def _stopped(service: Connection, port: int) -> api.Stopped:
    """The stop by the service on a UDP port; without one the process of this user that holds the port is asked for it.

    That process gets the signal that Ctrl-C in its terminal sends. Raises NothingToStopError.
    """
    from daemon.queue.control_socket import ServiceUnreachableError
    from daemon.runtime_folder import port_holders

    try:
        return replace(service, port=port).ask(api.StopMotion(), api.Stopped)
    except ServiceUnreachableError:
        holders = port_holders()
    if port not in holders:
        raise NothingToStopError(port, sorted(holders))
    try:
        os.kill(holders[port], signal.SIGINT)
    except ProcessLookupError:
        raise NothingToStopError(port, []) from None
    sentence = (
        f"Process {holders[port]}, which drives on UDP port {port}, was asked for the stop ramp; it ends with a "
        "confirmed standstill or says that it is not confirmed. If that is a service at an address of its own "
        "(control.endpoint), the service ends as well: with --endpoint it would have gone on."
    )
    return api.Stopped(was_moving=True, already=False, run=None, held=0, sentence=sentence)
