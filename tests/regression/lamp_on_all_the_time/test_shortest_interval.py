"""Half of the configured period was granted to a flash, though the tolerance let edges come at half of it.

Seen: compared with the frame period again in `core/sequencer.c`, 19.99 ms are staged: an LED on 99.9 % of the time.
"""

from annulus_pipe.controller import PIN_LED, PIN_SYNC, TICKS_PER_US
from annulus_pipe.link.codec import Decoder, Frame, encode
from annulus_pipe.link.messages import SCHEMA_HASH, Arm, ArmFlag, Command, Commit, Identify, Reply, Stage, StatusCode
from annulus_pipe.twin.native import NativeBoard

MS = 1000 * TICKS_PER_US


def ask(board: NativeBoard, command: Command, sequence: int) -> Reply:
    board.serial_write(encode(Frame(command, sequence)))
    board.run_until(board.tick + 2 * MS)
    frames = [item for item in Decoder().feed(board.serial_read()) if isinstance(item, Frame)]
    [reply] = [frame.message for frame in frames if isinstance(frame.message, command.REPLY)]
    return reply


def test_at_twice_the_configured_rate_a_lamp_keeps_its_duty() -> None:
    board = NativeBoard()
    board.power_on()
    assert ask(board, Identify(protocol=1, schema=SCHEMA_HASH), 0).status == StatusCode.OK
    timing = {"frame_period": 40 * MS, "exposure": 40 * MS, "readout": 0, "tolerance": 500, "host_timeout": 5000}
    for i, (width, expected) in enumerate(((1_999_000, StatusCode.DUTY), (10 * MS, StatusCode.OK))):
        lamps = {"projector_delay": 0, "projector_width": 0, "led_delay": 0, "led_width": width}
        assert ask(board, Stage(generation=1, ratio=0, **timing, **lamps), 1 + i).status == expected
    assert ask(board, Commit(generation=1), 3).status == StatusCode.OK
    assert ask(board, Arm(outputs=ArmFlag.LAMPS), 4).status == StatusCode.OK
    begin = board.tick + MS
    for i in range(50):
        board.input(begin + i * 20 * MS, PIN_SYNC, 0)
        board.input(begin + i * 20 * MS + 1_000, PIN_SYNC, 1)
    board.run_until(begin + 50 * 20 * MS)
    led = [(int(tick), int(level)) for tick, pin, level, *_ in board.pins().tolist() if pin == PIN_LED]
    on = sum(tick if level == 0 else -tick for tick, level in led)
    assert on == 50 * 10 * MS
