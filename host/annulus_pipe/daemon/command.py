"""Who commands a head: of several operators one changes things, the others see who it is.

A lease, kept by the daemon, which is the only one that all of them talk to. It ends by itself: an operator whose
machine is gone commands nothing. Where nobody commands, everybody may, as programs do that know of no command.

Who brings the holder's id is the holder, so it is a secret between him and the daemon. Everybody else knows him by
another, which a key drawn for this daemon makes of it: not even a short id can be guessed from that.
"""

import hashlib
import hmac
import secrets
from dataclasses import dataclass, field

from annulus_pipe.vocabulary import AnnulusError

COMMAND_S = 10.0  # from one renewal to the next at most; guarded by test_command.py
ID_MAX, NAME_MAX, ADDRESS_MAX = 40, 60, 60  # characters


@dataclass(frozen=True, slots=True)
class Operator:
    """Who asks. `id` is his secret, drawn at random: who brings it is him. `name` is for people, `address` where he
    says he sits, behind a console.
    """

    id: str = field(repr=False)
    name: str
    address: str = ""

    def is_same(self, other: "Operator") -> bool:
        return hmac.compare_digest(self.id.encode("utf-8", "replace"), other.id.encode("utf-8", "replace"))


class CommandLease:
    """The lease. Times are seconds of any one clock."""

    def __init__(self) -> None:
        self._holder: Operator | None = None
        self._since_s = self._until_s = 0.0
        self._key = secrets.token_bytes(16)

    def public_id(self, who: Operator) -> str:
        """What others may know him by: the same for as long as this daemon runs."""
        return hmac.new(self._key, who.id.encode("utf-8", "replace"), hashlib.sha256).hexdigest()[:16]

    def holder(self, now_s: float) -> Operator | None:
        """Who commands now."""
        if now_s >= self._until_s:
            self._holder = None
        return self._holder

    def ask(self, who: Operator | None, now_s: float, *, take: bool) -> str:
        """Begin, or go on. `take`: from another, too. Returns what everybody should know of it; nothing when it goes
        on.

        Raises AnnulusError when another commands, or nobody says who asks.
        """
        if who is None:
            raise AnnulusError("command: expected who asks, an id and a name")
        before = self.holder(now_s)
        if before is not None and not before.is_same(who) and not take:
            raise AnnulusError(f"{before.name} commands; take the command to change things yourself")
        fresh = before is None or not before.is_same(who)
        if fresh:
            self._since_s = now_s
        self._holder, self._until_s = who, now_s + COMMAND_S
        if not fresh:
            return ""
        return f"{who.name} commands" + ("" if before is None else f", taken from {before.name}")

    def release(self, who: Operator | None, now_s: float) -> str:
        """Nobody commands any more, where it was them."""
        before = self.holder(now_s)
        if before is None or who is None or not before.is_same(who):
            return ""
        self._holder = None
        return f"{who.name} does not command any more"

    def require(self, who: Operator | None, now_s: float) -> None:
        """Raises AnnulusError when somebody else commands. Who does and changes things is there: it goes on for him."""
        holder = self.holder(now_s)
        if holder is not None and (who is None or not who.is_same(holder)):
            raise AnnulusError(f"{holder.name} commands; take the command to change things yourself")
        if holder is not None:
            self._until_s = now_s + COMMAND_S

    def numbers(self, now_s: float) -> dict[str, object] | None:
        """For the telemetry."""
        holder = self.holder(now_s)
        return (
            None
            if holder is None
            else {"name": holder.name, "id": self.public_id(holder), "since_s": round(now_s - self._since_s, 1)}
        )
