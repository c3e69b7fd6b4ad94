"""Whose datagrams count: one robot's, from one address, once it is known."""

from __future__ import annotations

from fri_client.loop.channel import Address

RIVAL_DATAGRAMS = 10
"""So many of another machine are no stray packet: something sends there as a robot does."""
_MOST_RIVALS = 16


class Peer:
    """host: whose datagrams may count at all, None: anybody's. address: the robot's, None while none is known.

    foreign: datagrams of others. doubt: why it is not certain whose arm would move, as a clause; empty where a host was
    named, or one alone sends.
    """

    def __init__(self, host: str | None) -> None:
        self._host = host
        self.address: Address | None = None
        self.foreign = 0
        self.doubt = ""
        self._rivals: dict[str, int] = {}
        self._rival_heard = False  # since the robot's last message

    def may_be(self, address: Address) -> bool:
        """Whether a datagram from there may be the robot's; one that cannot be is counted."""
        if address == self.address or (self.address is None and self._host in (None, address[0])):
            return True
        self.foreign += 1
        if self._host is None and self.address is not None and address[0] != self.address[0]:
            self._rival_heard = True
            if not self.doubt:
                self._note_rival(address[0], self.address[0])
        return False

    def heard(self, address: Address) -> None:
        """A message that counts came from there: whoever is not known yet is the robot from now on."""
        if self.address is None:
            self.address = address
        self._rival_heard = False

    def release(self) -> None:
        """After a silence the robot may come back from another port, or another one may come.

        The doubt about two senders is dropped where the other machine was silent as well. Both stay known: one datagram
        of the one that is not the robot brings it back, and before a motion more of the robot's own have to come.
        """
        known = [host for host, count in self._rivals.items() if count >= RIVAL_DATAGRAMS]
        if self.address is not None:
            known.append(self.address[0])
        self._rivals = dict.fromkeys(known, RIVAL_DATAGRAMS - 1)
        if not self._rival_heard:
            self.doubt = ""
        self.address = None

    def _note_rival(self, host: str, robot: str) -> None:
        if host not in self._rivals and len(self._rivals) >= _MOST_RIVALS:
            return
        self._rivals[host] = self._rivals.get(host, 0) + 1
        if self._rivals[host] >= RIVAL_DATAGRAMS:
            self.doubt = (
                f"{host} sends to this port as well as {robot}, and nobody said which robot is meant: add "
                f"--robot-host {robot} (in the configuration: robot_host) if that is the arm to move, and see to what "
                f"{host} is"
            )
