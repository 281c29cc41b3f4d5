"""Who may connect: from this machine anybody, from outside only known CURVE keys. And what a secret's file must be.

One Doorkeeper serves all sockets of a ZeroMQ context: libzmq asks it (ZAP, RFC 27) before it lets anyone in.
"""

import ipaddress
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import zmq
from zmq.utils import z85

from annulus_pipe.vocabulary import AnnulusError

SECRET_MAX = 4096  # bytes of a key's or a password's file
HEARTBEAT_S = 2.0  # a client asks whether its daemon is there so often, ..
UNANSWERED_S = 10.0  # .. and connects again after so long without a word: a machine that lost its power tells nobody
CONNECT_S = 5.0  # for one try: the kernel would go on with the same for two minutes, ever more rarely


def read_secret(path: Path, limit: int = SECRET_MAX) -> bytes:
    """A file that holds a secret. What others may read is none any more, and what they own or may write is theirs:
    AnnulusError. OSError and ValueError as `untrusted.read_file` raises them.
    """
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        _require(path, os.fstat(file.fileno()))  # of what is read, whatever the name stands for a moment later
        data = file.read(limit + 1)
    if len(data) > limit:
        raise ValueError(f"larger than {limit} bytes")
    return data


def require_secret(path: Path) -> None:
    """For what another library reads. Raises AnnulusError, one line; OSError where it is not there."""
    _require(path, path.stat())


def _require(path: Path, file: os.stat_result) -> None:
    if not stat.S_ISREG(file.st_mode):
        raise ValueError("not a file")
    if file.st_uid not in (os.geteuid(), 0):
        raise AnnulusError(
            f"{path}: belongs to user {file.st_uid}, who can change it, expected this user's or root's: it is a secret"
        )
    if file.st_mode & 0o077:
        may = "read" if file.st_mode & 0o044 else "change"
        raise AnnulusError(
            f"{path}: others may {may} it, expected mode 600 and not {stat.S_IMODE(file.st_mode):03o}: it is a secret. "
            f"chmod 600 {path}, and make another where somebody may have read it"
        )


def curve_pair(path: Path, whose: str) -> tuple[str, str]:
    """Public and secret key (Z85) of a file that holds the secret one, 40 characters, and nothing else. `whose` it is,
    for people. Raises AnnulusError, one line.
    """
    try:
        secret = read_secret(path).decode("ascii").strip()
        return zmq.curve_public(secret.encode()).decode(), secret
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected {whose} secret key.") from None
    except (ValueError, zmq.ZMQError):
        raise AnnulusError(f"{path}: not a CURVE secret key. Expected 40 characters of Z85.") from None


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
