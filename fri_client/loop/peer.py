"""Whose datagrams count: one robot's, from one address, once it is known."""

from __future__ import annotations

from fri_client.loop.channel import Address


class Peer:
    """host: whose datagrams may count at all, None: anybody's. address: the robot's, None while none is known.

    foreign: datagrams of others.
    """

    __slots__ = ("_host", "address", "foreign")

    def __init__(self, host: str | None) -> None:
        self._host = host
        self.address: Address | None = None
        self.foreign = 0

    def may_be(self, address: Address) -> bool:
        """Whether a datagram from there may be the robot's; one that cannot be is counted."""
        if address == self.address or (self.address is None and self._host in (None, address[0])):
            return True
        self.foreign += 1
        return False
