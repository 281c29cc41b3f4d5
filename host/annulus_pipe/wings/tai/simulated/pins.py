"""What a controller's pins said of a burst, in virtual time and to the tick."""

import numpy as np
import numpy.typing as npt

from annulus_pipe.controller import PIN_MICROWAVE
from annulus_pipe.link.messages import Command, StatusCode
from annulus_pipe.link.session import Answer, LinkSession, identify
from annulus_pipe.twin.emulated import VirtualBoard
from annulus_pipe.vocabulary import AnnulusError

ANSWER_TICKS = 50_000_000


def pulses_of(pins: npt.NDArray[np.void]) -> list[tuple[int, int]]:
    """(rise, fall) in ticks of every whole microwave pulse among transitions."""
    pulses, rise = [], -1
    for tick, pin, level in pins.tolist():
        if pin == PIN_MICROWAVE and level:
            rise = tick
        elif pin == PIN_MICROWAVE and rise >= 0:
            pulses.append((rise, tick))
            rise = -1
    return pulses


def fire(board: VirtualBoard, *commands: Command, ticks: int = 1_000_000) -> npt.NDArray[np.void]:
    """What the pins of a powered board do when it is told these, in virtual time: TRANSITIONs until `ticks` after the
    last answer. AnnulusError for a command that is refused or not answered.
    """
    session, seen = LinkSession(), []
    for command in (identify(), *commands):
        ticket, end = session.send(command), board.tick + ANSWER_TICKS
        answer: Answer | None = None
        while answer is None and board.tick < end:
            board.serial_write(session.pending(board.tick * 10))
            board.run_until(board.tick + 10_000)
            for happening in session.receive(board.serial_read(), board.tick * 10):
                if isinstance(happening, Answer) and happening.ticket == ticket:
                    answer = happening
            seen.append(board.pins())
        if answer is None or answer.reply.status is not StatusCode.OK:
            why = "no answer" if answer is None else answer.reply.status.name.lower()
            raise AnnulusError(f"{type(command).__name__.lower()}: {why}, expected the board to carry it out")
    for _ in range(max(1, ticks // 10_000)):  # the processor is to be heard now and then, or it darkens
        board.serial_write(session.pending(board.tick * 10))
        board.run_until(board.tick + 10_000)
        session.receive(board.serial_read(), board.tick * 10)
        seen.append(board.pins())
    return np.concatenate(seen)
