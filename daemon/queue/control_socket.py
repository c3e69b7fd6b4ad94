"""The sockets of the control interface: the service's ROUTER, the client's one question, and who may use them.

Here: binding with file permissions, CURVE, size limits, framing. Not here: which addresses are allowed (`endpoints`),
what the bytes mean (`control_api`) and what is done about them (`server`). The service binds, the command line asks.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import zmq
from zmq.auth.thread import ThreadAuthenticator

from daemon.endpoints import endpoint_reason
from daemon.errors import ConfigurationError, DaemonError
from daemon.queue import control_api as api
from daemon.queue.keys import read_public_key, read_secret_key

ASK_TIMEOUT_S = 10.0
_MAXIMUM_REPLY_BYTES = 16 * 1024 * 1024
_QUEUED_REQUESTS = 16
"""Per client, so that requests of the largest size cannot pile up without end."""
_MAXIMUM_FRAMES = 3
_DOMAIN = "iiwa-ident"


class ServiceUnreachableError(DaemonError):
    """Nobody answers at the endpoint. Carries it."""

    exit_code = 69

    def __init__(self, endpoint: str, waited_s: float) -> None:
        self.endpoint = endpoint
        what = f"answered at {endpoint} within {waited_s:g} s" if waited_s else f"listens at {endpoint}"
        super().__init__(
            f"No service {what}: start it (`iiwa-ident daemon`), name its "
            "address (--endpoint), or, from another machine, a key that it knows (--key, --server-key)."
        )


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """CURVE on the service's side: its secret key's file, and the folder with the public keys of those it serves."""

    secret_key_file: Path
    authorised_clients: Path


def check_endpoint(endpoint: str, *, with_keys: bool) -> None:
    """Whether the service may listen there. Raises ConfigurationError."""
    reason = endpoint_reason(endpoint, with_keys=with_keys)
    if reason:
        raise ConfigurationError(reason, field="control.endpoint")


class ControlSocket:
    """The service's bound ROUTER; a context manager, for one thread. `endpoint` is where clients reach it."""

    def __init__(self, endpoint: str, keys: ServerKeys | None = None) -> None:
        """Bind. Raises ConfigurationError for an address that may not or cannot be used."""
        check_endpoint(endpoint, with_keys=keys is not None)
        self.malformed = 0
        self._path: str | None = None
        self._context: zmq.Context[Any] = zmq.Context()
        self._authenticator: ThreadAuthenticator | None = None
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.linger = 500
        self._socket.rcvhwm = _QUEUED_REQUESTS
        self._socket.sndhwm = _QUEUED_REQUESTS
        self._socket.setsockopt(zmq.MAXMSGSIZE, api.MAXIMUM_REQUEST_BYTES)
        # A peer that vanished without a word does not hold memory for ever.
        self._socket.setsockopt(zmq.HEARTBEAT_IVL, 5000)
        self._socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 15000)
        try:
            if keys is not None:
                self._require_keys(keys)
            self._bind(endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise ConfigurationError(f"{endpoint} cannot be bound: {error}.", field="control.endpoint") from error
        except BaseException:
            self.close()
            raise
        self.endpoint = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def _require_keys(self, keys: ServerKeys) -> None:
        public, secret = read_secret_key(keys.secret_key_file)
        if not keys.authorised_clients.is_dir():
            raise ConfigurationError(
                f"{keys.authorised_clients} is no folder; the public keys (*.key) of authorised clients belong there.",
                field="control.authorised_clients",
            )
        for file in sorted(keys.authorised_clients.glob("*.key")):
            read_public_key(file)
        self._authenticator = ThreadAuthenticator(self._context)
        self._authenticator.start()
        self._authenticator.configure_curve(domain=_DOMAIN, location=str(keys.authorised_clients))
        self._socket.curve_secretkey = secret
        self._socket.curve_publickey = public
        self._socket.curve_server = True
        # With a domain nobody is let in when the authenticator is not there; without one everybody would be.
        self._socket.zap_domain = _DOMAIN.encode()

    def _bind(self, endpoint: str) -> None:
        path = endpoint.removeprefix("ipc://") if endpoint.startswith("ipc://") else None
        # ZeroMQ would take the name away from a service that has it.
        if path is not None and _is_served(path):
            raise ConfigurationError(f"another service answers at {endpoint} already.", field="control.endpoint")
        before = os.umask(0o177)
        try:
            self._socket.bind(endpoint)
        finally:
            os.umask(before)
        if path is not None:
            os.chmod(path, 0o600)
            self._path = path

    def receive(self, timeout_s: float) -> Iterator[tuple[list[bytes], bytes]]:
        """Pairs (address to answer, bytes of a request), waiting at most timeout_s for the first; a batch at most."""
        if not self._socket.poll(int(timeout_s * 1000)):
            return
        for _ in range(_QUEUED_REQUESTS):
            try:
                frames = self._socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            # REQ puts an empty frame between address and message, DEALER need not.
            if len(frames) < 2 or len(frames) > _MAXIMUM_FRAMES or (len(frames) == _MAXIMUM_FRAMES and frames[1]):
                self.malformed += 1
                continue
            yield frames[:-1], frames[-1]

    def reply(self, address: list[bytes], message: api.ControlReply) -> None:
        """Answer, if anybody still waits for it; never waits."""
        with contextlib.suppress(zmq.ZMQError):
            self._socket.send_multipart([*address, msgspec.json.encode(message)], zmq.NOBLOCK)

    def close(self) -> None:
        """Close the socket; its file goes with it."""
        if self._authenticator is not None:
            self._authenticator.stop()
        self._socket.close()
        self._context.term()
        if self._path is not None:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(self._path)

    def __enter__(self) -> ControlSocket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _is_served(path: str) -> bool:
    with socket.socket(socket.AF_UNIX) as probe:
        try:
            probe.connect(path)
        except OSError:
            return False
        return True


def ask(
    endpoint: str,
    request: api.ControlRequest,
    *,
    key_file: Path | None = None,
    server_key_file: Path | None = None,
    timeout_s: float = ASK_TIMEOUT_S,
) -> api.ControlReply:
    """Put one question to the service at `endpoint` and return its answer.

    Raises ServiceUnreachableError (69) when none comes in time, RefusedRequestError when the answer is an error.
    """
    if (key_file is None) != (server_key_file is None):
        raise ConfigurationError("Both keys are needed: the client's secret one and the service's public one.")
    data = msgspec.json.encode(request)
    api.require_length(data)
    if endpoint.startswith("ipc://") and not _is_served(endpoint.removeprefix("ipc://")):
        raise ServiceUnreachableError(endpoint, 0.0)
    with zmq.Context() as context, context.socket(zmq.REQ) as channel:
        channel.linger = 0
        channel.setsockopt(zmq.MAXMSGSIZE, _MAXIMUM_REPLY_BYTES)
        if key_file is not None and server_key_file is not None:
            channel.curve_publickey, channel.curve_secretkey = read_secret_key(key_file)
            channel.curve_serverkey = read_public_key(server_key_file)
        try:
            channel.connect(endpoint)
        except zmq.ZMQError as error:
            raise ConfigurationError(f"'{endpoint}' is no address: {error}.", field="--endpoint") from error
        channel.send(data)
        if not channel.poll(int(timeout_s * 1000)):
            raise ServiceUnreachableError(endpoint, timeout_s)
        reply = api.decode_reply(channel.recv())
    if isinstance(reply, api.ErrorReply):
        raise api.RefusedRequestError(reply.code, reply.sentence, reply.exit_code)
    return reply
