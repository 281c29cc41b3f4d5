"""Events asked for again, on the shipped image."""

from emulated import MS, EmulatedBoard

from annulus.link.messages import Edge, Reread, RereadReply, StatusCode


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
