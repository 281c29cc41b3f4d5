"""Who may: the password, sessions with their tokens, from where a request may come, and how often. Sans-I/O but for the
password's file.

On loopback nobody logs in: whoever has an account on this machine may. Anywhere else a page is served over TLS only,
and wants the password. Either way a session, kept in a cookie that other sites' requests do not carry, gives what it
asks for a token to send along, so that no other page of that browser can ask in its name.
"""

import base64
import contextlib
import hashlib
import hmac
import ipaddress
import json
import math
import os
import secrets
import socket
from collections import OrderedDict
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path

from zmq.utils import z85

from annulus_pipe import untrusted
from annulus_pipe.stream.access import SECRET_MAX, ClientKeys, curve_pair, read_secret
from annulus_pipe.vocabulary import AnnulusError

SESSIONS_MAX = 256
IDLE_S = 12 * 3600.0  # a session nobody used; a connected page uses it
CONFIRM_S = 10.0  # how long the second step before lamps stands
CONFIRMS_MAX = 8
NAME_MAX = 60
ADDRESSES_MAX = 1000  # whose rates are known at once
POSTS, LOGINS, GETS = (20.0, 40.0), (1 / 6, 5.0), (100.0, 400.0)  # a second, and at once
LOGINS_OF_ALL = (0.5, 20.0)
PASSWORD_MAX = 200
_ALPHABET = "abcdefghjkmnpqrstuvwxyz23456789"  # nothing that is read for another
_SCRYPT_N, _SCRYPT_R, _SCRYPT_P, _SCRYPT_MEMORY = 1 << 15, 8, 1, 1 << 26


class Bucket:
    """So many a second, and so many at once."""

    def __init__(self, rate: float, burst: float, now_s: float) -> None:
        self._rate, self._burst = rate, burst
        self._level, self._at = burst, now_s

    def take(self, now_s: float) -> bool:
        self._level = min(self._burst, self._level + self._rate * (now_s - self._at))
        self._at = now_s
        if self._level < 1.0:
            return False
        self._level -= 1.0
        return True


class Rates:
    """A bucket for each who asks; of those who are many, the ones that asked last."""

    def __init__(self, rate: tuple[float, float]) -> None:
        self._rate = rate
        self._buckets: OrderedDict[str, Bucket] = OrderedDict()

    def take(self, who: str, now_s: float) -> bool:
        bucket = self._buckets.get(who)
        if bucket is None:
            bucket = self._buckets[who] = Bucket(*self._rate, now_s)
            if len(self._buckets) > ADDRESSES_MAX:
                self._buckets.popitem(last=False)
        self._buckets.move_to_end(who)
        return bucket.take(now_s)


@dataclass(slots=True)
class BrowserSession:
    """One browser. `id` is what others may know of it, `cookie` and `token` are its own; `lease`, by which the daemon
    knows who commands, is told to nobody but the daemon.
    """

    allowed: bool  # logged in, or nobody has to
    seen_s: float
    name: str = ""
    id: str = field(default_factory=lambda: secrets.token_hex(8))
    cookie: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    lease: str = field(default_factory=lambda: secrets.token_hex(16), repr=False)
    address: str = ""  # where its last request came from
    confirms: dict[str, float] = field(default_factory=dict)  # and until when

    def is_token(self, given: str) -> bool:
        return hmac.compare_digest(self.token.encode(), given.encode("utf-8", "replace"))

    def arm(self, now_s: float) -> str:
        """The first step: a one-time word that the second must bring."""
        for old in [word for word, until in self.confirms.items() if until < now_s]:
            del self.confirms[old]
        while len(self.confirms) >= CONFIRMS_MAX:
            del self.confirms[next(iter(self.confirms))]
        word = secrets.token_urlsafe(16)
        self.confirms[word] = now_s + CONFIRM_S
        return word

    def confirm(self, word: object, now_s: float) -> bool:
        until = self.confirms.pop(word, -math.inf) if isinstance(word, str) else -math.inf
        return now_s <= until


class Sessions:
    """All of them, bounded: a session with a page connected never makes room for a new one."""

    def __init__(self, needs_login: bool) -> None:
        self.needs_login = needs_login
        self.in_use: Callable[[BrowserSession], bool] = lambda session: False
        self._known: OrderedDict[str, BrowserSession] = OrderedDict()  # by cookie, used last at the end

    def of(self, cookie: str | None, now_s: float) -> BrowserSession | None:
        session = self._known.get(cookie or "")
        if session is None:
            return None
        if now_s - session.seen_s > IDLE_S and not self.in_use(session):
            del self._known[session.cookie]
            return None
        session.seen_s = now_s
        self._known.move_to_end(session.cookie)
        return session

    def begin(self, now_s: float, *, allowed: bool | None = None, name: str = "") -> BrowserSession:
        if len(self._known) >= SESSIONS_MAX:
            for old in list(self._known.values()):
                if not self.in_use(old):
                    del self._known[old.cookie]
                    break
            else:
                raise AnnulusError(f"{SESSIONS_MAX} browsers are connected, expected fewer")
        session = BrowserSession(not self.needs_login if allowed is None else allowed, now_s, name)
        self._known[session.cookie] = session
        return session

    def end(self, session: BrowserSession) -> None:
        self._known.pop(session.cookie, None)

    def __len__(self) -> int:
        return len(self._known)


class RequestOrigins:
    """From where a request may come: names by which this console is reached. Another site's page that has its name
    resolved to this machine (DNS rebinding) brings that name along as Host, and is none of them; one of another origin
    says so as Origin.
    """

    def __init__(self, host: str, tls: bool, names: Collection[str] = ()) -> None:
        self.scheme = "https" if tls else "http"
        self._any_address = not is_loopback(host)
        self._names = {"localhost", "127.0.0.1", "::1", host.lower(), *(name.lower() for name in names)}
        if self._any_address:
            own = socket.gethostname().lower()
            self._names |= {own, f"{own.partition('.')[0]}.local"}

    def is_ours(self, host: str) -> bool:
        """Whether a Host header names this console, by whatever port: one may be forwarded."""
        name, port = split_host(host)
        if name is None or not (port == "" or (port.isascii() and port.isdigit() and int(port) < 65536)):
            return False
        if name.lower() in self._names:
            return True
        if not self._any_address:
            return False
        with contextlib.suppress(ValueError):  # an address is no name that somebody else can have resolved
            return ipaddress.ip_address(name) is not None
        return False

    def is_same(self, origin: str, host: str) -> bool:
        """Whether an Origin header is the page that this Host served."""
        return origin.lower() == f"{self.scheme}://{host.lower()}"


def split_host(host: str) -> tuple[str | None, str]:
    """(name or address, port as text) of a Host header; None where it is none."""
    if host.startswith("["):
        name, closed, rest = host[1:].partition("]")
        return (name, rest.removeprefix(":")) if closed and (not rest or rest.startswith(":")) else (None, "")
    name, colon, port = host.partition(":")
    return (name, port) if name and ":" not in port and bool(colon) == bool(port) else (None, "")


def is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def named(name: object) -> str:
    """A person's name as everybody is shown it: one line, nothing that a terminal would obey."""
    return untrusted.printable(" ".join(untrusted.text(name, "name", NAME_MAX).split()))[:NAME_MAX].strip()


class Password:
    """Kept as its scrypt hash, in a file that only this user reads."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def made(self) -> str:
        """A new password. Only its hash is kept: the caller is the last to see the password itself."""
        word = "-".join("".join(secrets.choice(_ALPHABET) for _ in range(4)) for _ in range(4))
        salt = secrets.token_bytes(16)
        kept = {name: base64.b64encode(one).decode() for name, one in (("salt", salt), ("hash", _hash(word, salt)))}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            draft = self.path.with_name(f"{self.path.name}.{os.getpid()}")
            with open(draft, "x", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
                json.dump(kept, file)
            os.replace(draft, self.path)
        except OSError as error:
            raise AnnulusError(f"{self.path}: the password cannot be kept ({error.strerror})") from None
        return word

    @property
    def is_there(self) -> bool:
        return self.path.exists()

    def check(self, word: str) -> bool:
        """Takes 0.1 s, on purpose. Raises AnnulusError when the file is not as it was made."""
        try:
            kept = untrusted.mapping(untrusted.parse_json(read_secret(self.path), SECRET_MAX), "password")
            salt, known = (base64.b64decode(untrusted.text(kept.get(name), name, 200)) for name in ("salt", "hash"))
        except (OSError, ValueError) as error:
            raise AnnulusError(f"{self.path}: no password can be read there ({error})") from None
        return hmac.compare_digest(_hash(word, salt), known)


def password_file() -> Path:
    """Of this user, whichever console asks."""
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local/state")
    return Path(state) / "annulus/console-password.json"


def _hash(word: str, salt: bytes) -> bytes:
    plain = word[:PASSWORD_MAX].encode("utf-8", "replace")
    return hashlib.scrypt(plain, salt=salt, n=_SCRYPT_N, r=_SCRYPT_R, p=_SCRYPT_P, maxmem=_SCRYPT_MEMORY, dklen=32)


def client_keys(path: Path, server: str) -> ClientKeys:
    """For a daemon whose public key is `server`; the file holds our secret key, 40 characters of Z85, nothing else."""
    public, secret = curve_pair(path, "the console's")
    try:
        known = len(server) == 40 and len(z85.decode(server.encode())) == 32
    except (KeyError, ValueError):
        known = False
    if not known:
        raise AnnulusError(f"{untrusted.shown(server)} is no public CURVE key, expected 40 characters of Z85")
    return ClientKeys(server, public, secret)
