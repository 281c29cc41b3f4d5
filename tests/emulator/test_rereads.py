"""Events asked for again, on the shipped image."""

from emulated import MS, EmulatedBoard

from annulus_pipe.controller import PIN_ODOMETER_A, PIN_ODOMETER_B
from annulus_pipe.link.messages import (
    LEVEL,
    SCHEMA_HASH,
    Edge,
    Fault,
    FaultCode,
    Identify,
    Info,
    Reread,
    RereadReply,
    StatusCode,
)


def test_every_event_promised_comes_however_many_rereads_are_outstanding(board: EmulatedBoard) -> None:
    """Two at once: 25 were promised and 7 came, since the second took the place of the first."""
    board.identify()
    for i in range(40):
        board.pulse(board.now + MS + 300_000 * i)
    board.run(board.now + 130 * MS)
    before = dict(zip(board.event_sequences, board.events, strict=True))
    first = next(sequence for sequence, event in before.items() if isinstance(event, Edge))
    board.events.clear()
    board.event_sequences.clear()
    asked = [(first, 18), (first + 20, 7), (first + 5, 3), (first, 1)]
    for start, count in asked:
        board.send(Reread(first=start, count=count))
    board.run(board.now + 30 * MS)
    promised = [reply for reply in board.replies if isinstance(reply, RereadReply)]
    assert [(reply.status, reply.first, reply.count) for reply in promised] == [(StatusCode.OK, *run) for run in asked]
    assert board.event_sequences == [start + i for start, count in asked for i in range(count)]
    assert board.events == [before[sequence] for sequence in board.event_sequences]


def test_a_host_of_level_1_is_told_of_an_added_fault_as_it_can_read_it(board: EmulatedBoard) -> None:
    """It would take the code for damage, miss the number, and ask again for ever."""
    board.request(Identify(protocol=1, schema=SCHEMA_HASH))  # and no info
    board.run(board.now + MS)
    for level in (1, 0):  # both lines at once: no direction
        board.input((board.now + 100, PIN_ODOMETER_A, 1 - level), (board.now + 100, PIN_ODOMETER_B, 1 - level))
        board.run(board.now + 5 * MS)
    first = len(board.events)
    told = board.heard(Fault)
    assert told and {fault.fault for fault in told} == {FaultCode.NONE}
    assert {fault.detail for fault in told} == {FaultCode.ODOMETER}
    assert board.event_sequences == list(range(first)) and board.bad == 0
    board.request(Info(level=LEVEL))
    board.request(Reread(first=0, count=first))
    board.run(board.now + 5 * MS)
    again = [event for event in board.events[first:] if isinstance(event, Fault)]
    assert {fault.fault for fault in again} == {FaultCode.ODOMETER}
