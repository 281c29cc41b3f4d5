"""The image under test as a Board of annulus_pipe.selftest.rig: what is asked of silicon is asked of the emulator."""

from emulated import BOOTED, MS, EmulatedBoard

from annulus_pipe.controller import PIN_END_HIGH, PIN_END_LOW, PIN_INTERLOCK, PIN_INTERLOCK_ANTIVALENT
from annulus_pipe.link.codec import Frame, encode
from annulus_pipe.link.messages import Command, IdentifyReply, Reply, Status
from annulus_pipe.selftest.rig.board import EdgeIn, Played, Scene

STEP = MS // 2
ALIVE = 20 * MS
NOISE = bytes(range(1, 81)) + b"\0"


class PromiseBoard:
    """Exact, and without the host's delays."""

    def __init__(self, board: EmulatedBoard) -> None:
        self.board = board
        board.input(*[(board.now, pin, 0) for pin in (PIN_INTERLOCK, PIN_END_LOW, PIN_END_HIGH)])
        board.input((board.now, PIN_INTERLOCK_ANTIVALENT, 1))
        board.run(max(BOOTED, board.now) + 80 * MS)  # what the last burst before the reset may owe is paid
        board.identify()

    def slack(self, span: float = 0) -> float:
        return 0.0

    def identify(self) -> IdentifyReply:
        return self.board.identify()

    def request(self, command: Command) -> Reply:
        return self.board.request(command)

    def play(self, scene: Scene) -> Played:
        board = self.board
        board.run(board.now + STEP)
        begin, heard, seen = board.now, len(board.events), len(board.transitions)
        cued = 0 if scene.cue is None else self._next_rise(scene.cue) - begin
        edges = sorted((round(tick) + cued, pin, level) for tick, pin, level in scene.edges)
        board.input(*[(begin + tick, pin, level) for tick, pin, level in edges])
        orders, replies, end, spoken = list(scene.orders), [], begin + scene.until, begin
        while board.now < end or orders:
            if orders and board.now >= begin + orders[0][0]:
                replies.append(board.request(orders.pop(0)[1]))
                end = max(end, board.now + scene.after)
                continue
            if scene.flood:
                board.write(encode(Frame(Status(), 0)) + NOISE)
            elif not scene.silent and board.now >= spoken + ALIVE:
                board.send(Status())
                spoken = board.now
            due = [begin + tick for tick, _ in orders[:1]]
            board.run(min([board.now + STEP, *due] + ([end] if end > board.now else [])))
        transitions: list[EdgeIn] = [(tick - begin, pin, level) for tick, pin, level in board.transitions[seen:]]
        return Played(list(edges), transitions, board.events[heard:], replies, origin=begin - board.origin)

    def _next_rise(self, pin: int) -> int:
        """Of a train that runs: as far from its last rise as that was from the one before."""
        board = self.board
        count = len(board.rises(pin))
        while len(board.rises(pin)) < count + 2:
            board.run(board.now + STEP)
        before, last = board.rises(pin)[-2:]
        due = last + (last - before)
        while due <= board.now:
            due += last - before
        return due
