"""How far a camera's labels are to be believed, as a table: (state, what a frame said) -> state.

    searching -found-> proved -contradiction-> doubted -agreed again-> proved
        ^                |                        |
        +----adrift------+--------given up--------+
    given (an offset of another day) -> tentative -agreed-> proved, -contradiction-> searching

Adrift: frames may have been kept or lost by whole lamp cycles, which only the pictures of a preamble can tell.

A label is given in PROVED only, and never to the frame that contradicts. What says nothing of the offset (an edge that
was not heard, a torn picture) costs that frame its label and changes nothing.
"""

from collections.abc import Mapping
from enum import StrEnum


class ProofState(StrEnum):
    SEARCHING = "searching"  # no offset is known
    TENTATIVE = "tentative"  # one is, from another day
    PROVED = "proved"  # pictures agreed under this one, and under no other that is possible
    DOUBTED = "doubted"  # a witness has contradicted


class Witness(StrEnum):
    """Who has a say in which flash lit a frame, beside its timestamp."""

    ARRIVAL = "arrival"  # when the frame was in hand
    ORDER = "order"  # one frame an edge, edges rising
    COUNT = "count"  # the driver's
    LAMP = "lamp"  # what the picture shows as a whole
    TORN = "torn"  # .. and in bands
    REPEATED = "repeated"  # .. and whether it was shown before
    PREAMBLE = "preamble"  # flashes that come in no cycle


class Reason(StrEnum):
    """Why a frame got its label. Everything but AGREED means unknown."""

    AGREED = "agreed"
    NO_EDGE = "no edge near"
    TWO_EDGES = "two edges near"
    BETWEEN = "stamped between two edges"
    OPENING_LOST = "opening edge lost"
    IRREGULAR = "irregular edge"
    LATE = "flash loaded late"
    DISARMED = "disarmed"
    DARK = "no flash"
    CUT = "fault or arming during the frame"
    EARLY = "in hand before its edge"
    WAITED = "came late, and the driver does not count"
    LATER = "comes late for good, and the driver does not count"
    SKIPPED = "frames are missing, and the driver does not count"
    ORDER = "edge already had its frame"
    SEQUENCE = "driver count disagrees"
    PICTURE = "picture disagrees"
    BLANK = "picture blank"
    UNCLEAR = "picture unclear"
    TORN = "picture of two exposures"
    REPEATED = "picture was shown before"
    OFFSET = "timestamp offset doubtful"


class News(StrEnum):
    """What moves the state."""

    FOUND = "found"  # the search found the one offset that fits
    GIVEN = "given"  # somebody brings one
    AGREED = "agreed"  # enough frames, no other shift explains them
    EARLY = Reason.EARLY
    ORDER = Reason.ORDER
    SEQUENCE = Reason.SEQUENCE
    BETWEEN = Reason.BETWEEN
    LATER = Reason.LATER
    PICTURE = Reason.PICTURE
    SKIPPED = Reason.SKIPPED  # where stamps are made on delivery
    REPEATED = Reason.REPEATED
    BLANK = Reason.BLANK
    GIVEN_UP = "given up"  # too long in doubt, or three pictures against it
    ADRIFT = "adrift"


CONTRADICTIONS = frozenset({News.EARLY, News.ORDER, News.SEQUENCE, News.BETWEEN, News.LATER, News.PICTURE})
# What contradicts nobody, and withdraws the proof all the same.
SUSPICIONS = frozenset({News.SKIPPED, News.REPEATED, News.BLANK})

TRANSITIONS: Mapping[tuple[ProofState, News], ProofState] = {
    (ProofState.SEARCHING, News.FOUND): ProofState.PROVED,
    (ProofState.SEARCHING, News.GIVEN): ProofState.TENTATIVE,
    (ProofState.TENTATIVE, News.FOUND): ProofState.PROVED,
    (ProofState.TENTATIVE, News.GIVEN): ProofState.TENTATIVE,
    (ProofState.TENTATIVE, News.AGREED): ProofState.PROVED,
    (ProofState.PROVED, News.FOUND): ProofState.PROVED,
    (ProofState.PROVED, News.GIVEN): ProofState.TENTATIVE,
    (ProofState.DOUBTED, News.FOUND): ProofState.PROVED,
    (ProofState.DOUBTED, News.GIVEN): ProofState.TENTATIVE,
    (ProofState.DOUBTED, News.AGREED): ProofState.PROVED,
    (ProofState.DOUBTED, News.GIVEN_UP): ProofState.SEARCHING,
    **{(state, News.ADRIFT): ProofState.SEARCHING for state in ProofState},
    **{(ProofState.TENTATIVE, news): ProofState.SEARCHING for news in CONTRADICTIONS | SUSPICIONS},
    **{(ProofState.PROVED, news): ProofState.DOUBTED for news in CONTRADICTIONS | SUSPICIONS},
    **{(ProofState.DOUBTED, news): ProofState.DOUBTED for news in CONTRADICTIONS | SUSPICIONS},
}


def next_state(state: ProofState, news: News) -> ProofState:
    """What is not in the table changes nothing."""
    return TRANSITIONS.get((state, news), state)
