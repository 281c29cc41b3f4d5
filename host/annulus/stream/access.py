"""Who may connect: from this machine anybody, from outside only known CURVE keys.

One Doorkeeper serves all sockets of a ZeroMQ context: libzmq asks it (ZAP, RFC 27) before it lets anyone in.
"""

import ipaddress
from dataclasses import dataclass
from urllib.parse import urlsplit

import zmq
from zmq.utils import z85

from annulus.vocabulary import AnnulusError

HEARTBEAT_S = 2.0  # a client asks whether its daemon is there so often, ..
UNANSWERED_S = 10.0  # .. and connects again after so long without a word: a machine that lost its power tells nobody
CONNECT_S = 5.0  # for one try: the kernel would go on with the same for two minutes, ever more rarely


@dataclass(frozen=True, slots=True)
class Keys:
    """CURVE: the server's key pair, and the public keys of the viewers let in (Z85 text, 40 characters each)."""

    public: str
    secret: str
    viewers: frozenset[str]

    def __post_init__(self) -> None:
        for key in (self.public, self.secret, *self.viewers):
            try:
                valid = len(key) == 40 and len(z85.decode(key)) == 32
            except (KeyError, ValueError):
                valid = False
            if not valid:
                raise AnnulusError("a CURVE key must be 40 characters of Z85, as `zmq.curve_keypair()` makes them")


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """CURVE, Z85 text: the daemon's public key, and the client's own pair."""

    server: str
    public: str
    secret: str


def connected(
    context: zmq.Context[zmq.Socket[bytes]], kind: int, address: str, keys: ClientKeys | None, carried_max: int
) -> zmq.Socket[bytes]:
    """A client's socket; what is longer than `carried_max` bytes ends the connection, and so does a daemon that does
    not answer: libzmq then connects again by itself. Raises AnnulusError when the address is none.
    """
    socket = context.socket(kind)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.MAXMSGSIZE, carried_max)
    socket.setsockopt(zmq.HEARTBEAT_IVL, round(1000 * HEARTBEAT_S))
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, round(1000 * UNANSWERED_S))
    socket.setsockopt(zmq.CONNECT_TIMEOUT, round(1000 * CONNECT_S))
    if keys is not None:
        socket.curve_serverkey = keys.server.encode()
        socket.curve_publickey, socket.curve_secretkey = keys.public.encode(), keys.secret.encode()
    try:
        socket.connect(address)
    except zmq.ZMQError as error:
        socket.close()
        raise AnnulusError(f"{address}: {error.strerror}, expected tcp://ADDRESS:PORT of a daemon") from None
    return socket


class Doorkeeper:
    """Binds sockets under the one rule, and answers for who knocks."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]]) -> None:
        self.context = context
        self._door: zmq.Socket[bytes] | None = None
        self._viewers: dict[bytes, frozenset[bytes]] = {}  # by ZAP domain

    def bind(self, socket: zmq.Socket[bytes], address: str, keys: Keys | None, what: str, carried_max: int) -> str:
        """Bind `socket` and return where it really is. `what` it is for, in messages and as the ZAP domain. Who sends
        more than `carried_max` bytes at once, in the handshake or after it, is disconnected: libzmq would keep them.

        Raises AnnulusError, with the socket closed, when the address is taken, is not one, or is remote without keys.
        """
        if keys is None and not is_loopback(address):
            socket.close()
            raise AnnulusError(f"{what} address {address} is not loopback: viewers from outside need CURVE keys")
        try:
            if keys is not None:
                self._open()
                self._viewers[what.encode()] = frozenset(key.encode() for key in keys.viewers)
                socket.curve_server = True
                socket.curve_secretkey = keys.secret.encode()
                socket.zap_domain = what.encode()
            socket.setsockopt(zmq.MAXMSGSIZE, carried_max)  # before bind: later it does not reach those who connect
            socket.bind(address)
        except zmq.ZMQError as error:
            socket.close()
            raise AnnulusError(
                f"cannot {what} on {address}: {error.strerror}. Expected tcp://ADDRESS:PORT that is free."
            ) from None
        return socket.getsockopt_string(zmq.LAST_ENDPOINT)

    def admit(self) -> None:
        """Answer those who wait at the door. Call regularly; does not wait."""
        while self._door is not None and self._door.poll(0):
            request = self._door.recv_multipart()
            version, number, domain = request[0], request[1], request[2]
            mechanism, key = (request[5], request[6]) if len(request) == 7 else (b"", b"")
            known = mechanism == b"CURVE" and len(key) == 32 and z85.encode(key) in self._viewers.get(domain, ())
            verdict = (b"200", b"OK") if known else (b"400", b"viewer's key is not on the list")
            self._door.send_multipart([version, number, *verdict, b"", b""])

    def close(self) -> None:
        if self._door is not None:
            self._door.close()

    def _open(self) -> None:
        if self._door is None:
            self._door = self.context.socket(zmq.REP)
            self._door.setsockopt(zmq.LINGER, 0)
            self._door.bind("inproc://zeromq.zap.01")


def is_loopback(address: str) -> bool:
    """True for addresses only this machine reaches."""
    if address.startswith(("inproc://", "ipc://")):
        return True
    host = urlsplit(address).hostname
    if host == "localhost":
        return True
    try:
        return host is not None and ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
