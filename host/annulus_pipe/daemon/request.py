"""What a client of the control socket may ask, checked field by field.

    {"do": "start", "record": true, "hold_s": 10.0, "who": {"id": .., "name": .., "from": ..}}

Who began a scan, or a trial, is told its number. A request that names one is about that scan and no other: whoever was
away for a moment neither ends nor changes what somebody else has begun since.

Every request may say who asks; what else one may have is in FIELDS. Whatever is not known is refused: a client that
misspells a key must not be taken to have asked for something else.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Self

from annulus_pipe import untrusted
from annulus_pipe.daemon.command import ADDRESS_MAX, ID_MAX, NAME_MAX, Operator
from annulus_pipe.job import WORDS, JobSheet, emptied

REQUEST_MAX = 4096  # bytes
PHOTO_MAX = 48 << 10  # bytes of a JPEG
MARK_MAX = PHOTO_MAX + REQUEST_MAX
TEXT_MAX = 500  # characters
HOLD_S, HOLD_MAX_S = 10.0, 30.0  # that lamps stay on in a trial which nobody renews
LAMP_KEYS = ("ratio", "projector_delay_us", "projector_width_us", "led_delay_us", "led_width_us")
LAMP_MAX_US = 1e6
SCAN_MAX = (1 << 32) - 1  # the largest number of a scan


class Do(StrEnum):
    START = "start"
    STOP = "stop"
    PAUSE = "pause"
    RESUME = "resume"
    HOLD = "hold"  # a trial, for longer
    MARK = "mark"
    ZERO = "zero"
    STATE = "state"
    ABOUT = "about"
    JOB = "job"
    LAMPS = "lamps"
    COMMAND = "command"
    RELEASE = "release"


FIELDS: Mapping[Do, tuple[str, ...]] = {
    Do.START: ("record", "hold_s"),
    Do.STOP: ("scan",),
    Do.HOLD: ("hold_s", "scan"),
    Do.MARK: ("text", "clock_deg", "photo"),
    Do.JOB: ("job",),
    Do.LAMPS: ("lamps", "commit", "trial", "scan"),
    Do.COMMAND: ("take",),
}
COMMANDED = frozenset({Do.START, Do.RESUME, Do.HOLD, Do.ZERO, Do.JOB, Do.LAMPS})  # refused while somebody else commands


@dataclass(frozen=True, slots=True)
class Request:
    """What a client wants. Which fields mean something is in FIELDS."""

    do: Do
    text: str = ""
    clock_deg: float | None = None
    photo: bytes = field(default=b"", repr=False)  # a JPEG
    record: bool = True  # False: a trial, which ends `hold_s` after nobody asked for more
    hold_s: float = HOLD_S
    scan: int | None = None  # the one that is meant; None: whichever is under way
    job: JobSheet | None = None
    emptied: frozenset[str] = frozenset()  # fields of the job that are to be empty
    lamps: Mapping[str, float] = field(default_factory=dict)  # of LAMP_KEYS, what is to be another
    commit: bool = False  # put them in force
    trial: bool = False  # .. until the trial ends, and whatever rows are open
    take: bool = False
    who: Operator | None = None
    peer: str = field(default="", compare=False)  # where it came from, as its socket has it

    def summary(self) -> dict[str, Any]:
        """What is asked, for people and recordings: no photo, nobody's words but where they are nowhere else."""
        fields: dict[str, Any] = {"do": self.do.value}
        match self.do:
            case Do.START:
                fields |= {"record": self.record}
            case Do.LAMPS:
                fields |= {"lamps": dict(self.lamps), "commit": self.commit, "trial": self.trial}
            case Do.JOB if self.job is not None:
                fields |= {"job": sorted({*self.job.to_dict(), *self.emptied})}
            case Do.COMMAND:
                fields |= {"take": self.take}
        return fields

    @classmethod
    def unpack(cls, packed: bytes) -> Self:
        """Raises ValueError on anything but one well-formed request."""
        too_long = f"a request of {len(packed)} bytes, expected at most {REQUEST_MAX}"
        try:
            top = untrusted.unpack(packed, MARK_MAX)
        except ValueError as error:
            raise ValueError(too_long if len(packed) > REQUEST_MAX else str(error)) from None
        if len(packed) > REQUEST_MAX and not (isinstance(top, Mapping) and top.get("do") == Do.MARK):
            raise ValueError(too_long)
        return cls.from_dict(top)

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Check and convert. Raises ValueError naming what is wrong."""
        top = untrusted.mapping(data, "request")
        word = top.get("do")
        if not isinstance(word, str) or word not in set(Do):
            raise ValueError(f"do is {str(word)[:40]!r}, expected one of {', '.join(Do)}")
        do = Do(word)
        allowed = FIELDS.get(do, ())
        if top.keys() - {"do", "who", *allowed}:
            raise ValueError(f"{do}: expected nothing more" + (f", but {_listed(allowed)}" if allowed else ""))
        clock_deg, job, gone = top.get("clock_deg"), top.get("job"), emptied(top.get("job"))
        if isinstance(job, Mapping):
            job = {name: value for name, value in job.items() if name not in gone or name not in WORDS}
        return cls(
            do,
            text=untrusted.text(top.get("text", ""), "text", TEXT_MAX),
            clock_deg=None if clock_deg is None else untrusted.number(clock_deg, "clock_deg", 360.0),
            photo=_photo(top.get("photo", b"")),
            record=_flag(top, "record", True),
            hold_s=untrusted.within(top.get("hold_s", HOLD_S), "hold_s", 1.0, HOLD_MAX_S),
            scan=None if top.get("scan") is None else untrusted.whole(top["scan"], "scan", 0, SCAN_MAX),
            job=JobSheet.from_dict(job, "job") if do is Do.JOB else None,
            emptied=gone,
            lamps=_lamps(top.get("lamps", {})),
            commit=_flag(top, "commit", False),
            trial=_flag(top, "trial", False),
            take=_flag(top, "take", False),
            who=_who(top.get("who")),
        )


def _listed(names: tuple[str, ...]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _flag(top: Mapping[Any, Any], name: str, usual: bool) -> bool:
    value = top.get(name, usual)
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {untrusted.shown(value)}, expected true or false")
    return value


def _photo(value: object) -> bytes:
    if not isinstance(value, bytes) or len(value) > PHOTO_MAX or (value and value[:3] != b"\xff\xd8\xff"):
        raise ValueError(f"photo: expected a JPEG of at most {PHOTO_MAX} bytes")
    return value


def _lamps(value: object) -> dict[str, float]:
    given = untrusted.mapping(value, "lamps")
    if strange := [name for name in given if name not in LAMP_KEYS]:
        raise ValueError(f"lamps: {untrusted.shown(strange[0])} is not known, expected some of {', '.join(LAMP_KEYS)}")
    return {
        name: untrusted.whole(one, "lamps: ratio", 0, 15)
        if name == "ratio"
        else untrusted.within(one, f"lamps: {name}", 0.0, LAMP_MAX_US)
        for name, one in given.items()
    }


def _who(value: object) -> Operator | None:
    if value is None:
        return None
    who = untrusted.mapping(value, "who")
    if {*who, "from"} != {"id", "name", "from"}:
        raise ValueError("who: expected an id and a name, and perhaps from where")
    name = untrusted.printable(untrusted.text(who["name"], "who: name", NAME_MAX)).strip()
    own = untrusted.text(who["id"], "who: id", ID_MAX)
    if not name or not own:
        raise ValueError("who: expected an id and a name that are not empty")
    address = untrusted.printable(untrusted.text(who.get("from", ""), "who: from", ADDRESS_MAX)).strip()
    return Operator(own, name, address)
