"""The PIO programs twice over: their words against an assembler that is not ours, and the emulator's PIO, cycle by
cycle, against one that is not ours (rp2040-pio-emulator; it has no flags, so sync follower and lamp are not run on it).
"""

import itertools
import json
import os
import random
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import adafruit_pioasm
import pytest
from emulated import IMAGE
from pioemu import State, emulate

pytestmark = pytest.mark.skipif("ANNULUS_IMAGE" in os.environ, reason="another image is being judged, on its pins")

LAMPS = """
.program lamps
; SYNC. Counts down in y, a step every two cycles, and looks at the pin in between: high, then low is an edge.
high:
    jmp y-- look_high
look_high:
    jmp pin armed           ; wraps to high
armed:
    jmp y-- look_low
look_low:
    jmp pin armed
    irq 4                   ; accepted: at once, before the lamp's machine asks
    mov isr, y
    push noblock            ; the stamp
    pull noblock            ; a new hold-off, or x again
    mov x, osr
    irq clear 4
    irq clear 5 [1]
hold:
    jmp y-- held            ; time goes on, the pin is not looked at
held:
    jmp x-- hold
    mov x, osr
    irq 5                   ; look again
    jmp high [1]
; LAMP. Words: delay, width - 2, gates.
idle:
    pull block
    mov x, osr
    pull block
    mov y, osr
    pull block
    wait 1 irq 5
    wait 1 gpio 2
    wait 0 gpio 2
    mov isr, osr [1]
    wait 1 irq 4
    push noblock            ; this flash is taken
delay:
    jmp x-- delay
    mov pins, osr
width:
    jmp y-- width
    mov pins, null          ; wraps to idle
    jmp idle                ; the turntable's machine, whose wrap is elsewhere
"""
TRAIN = """
.program train
play:
    pull block
    out pins, 1
    out x, 31
rest:
    jmp x-- rest            ; wraps to play
; GUARD. Counts a credit down in x, a step every two cycles; cuts when the interlock's pin is high or no credit is left.
take:
    mov x, osr
public watch:
    jmp pin cut
    jmp x-- watch
public spent:
    pull noblock            ; the next credit, or x again: all ones
    jmp pin cut
    mov y, osr
    jmp x!=y take
public cut:
    set pins, 0             ; wraps to itself
"""
ODOMETER = """
.program odometer
again:
    mov isr, null
    in pins, 2
    mov x, isr
    jmp x!=y changed        ; wraps to again
changed:
    mov y, x
    push noblock
    jmp again
"""
# In place of `watch`, for an interlock of two inputs: a step every six cycles; the other pin, the lowest of its inputs,
# must be high. Two of its jumps lead into the program above.
GUARD_OF_TWO = """
.program guard_of_two
again:
    jmp pin {cut}
    mov osr, pins
    out y, 1
    jmp pin {cut}
    jmp !y {cut}
    jmp x-- again
    jmp {spent}
"""


def assembled(source: str, origin: int = 0) -> list[int]:
    """Words where they stand in the memory: jumps are absolute."""
    words = adafruit_pioasm.assemble(source)
    return [(word & ~31) | (word + origin & 31) if word >> 13 == 0 else word for word in words]


LABELS = adafruit_pioasm.Program(TRAIN).public_labels
TWO_AT = len(assembled(TRAIN)) + len(assembled(ODOMETER))
TWO = GUARD_OF_TWO.format(**{name: (at - TWO_AT) & 31 for name, at in LABELS.items()})
PROGRAMS = [  # with origin and block
    (LAMPS, 0, 0),
    (TRAIN, 0, 1),
    (ODOMETER, len(assembled(TRAIN)), 1),
    (TWO, TWO_AT, 1),
]


def tables(elf: bytes) -> dict[int, list[tuple[str, list[int]]]]:
    """Words of the C tables called program or counter in an ELF, by how many they are."""
    table, size, count, names_at = struct.unpack_from("<I", elf, 32)[0], *struct.unpack_from("<HHH", elf, 46)
    sections = [struct.unpack_from("<10I", elf, table + i * size) for i in range(count)]
    assert names_at < count
    symbols = next(s for s in sections if s[1] == 2)
    strings = sections[symbols[6]][4]
    found: dict[int, list[tuple[str, list[int]]]] = {}
    for at in range(symbols[4], symbols[4] + symbols[5], 16):
        name_at, value, length, _, _, section = struct.unpack_from("<IIIBBH", elf, at)
        name = elf[strings + name_at : elf.index(b"\0", strings + name_at)].decode()
        if name.split(".")[0] in ("program", "counter", "guard_both") and length:
            offset = sections[section][4] + value - sections[section][3]
            words = list(struct.unpack_from(f"<{length // 2}H", elf, offset))
            found.setdefault(length // 2, []).append((name, words))
    return found


class Pios:
    """Both PIO blocks of the booted image, and the emulator's PIO to be asked."""

    def __init__(self, image: Path) -> None:
        script = Path(__file__).with_name("pio_trace.mjs")
        self._process = subprocess.Popen(
            ["node", str(script), str(image)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self.blocks: list[dict[str, Any]] = json.loads(self._process.stdout.readline())

    def memory(self, block: int) -> list[int]:
        words: list[int | None] = self.blocks[block]["memory"]
        return [0xA042 if word is None else word for word in words]  # mov y, y: nothing

    def machine(self, block: int, index: int) -> dict[str, int]:
        machine: dict[str, int] = self.blocks[block]["machines"][index]
        return machine

    def trace(self, **question: Any) -> list[list[Any]]:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        rows: list[list[Any]] = json.loads(self._process.stdout.readline())
        return rows

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(10)


@pytest.fixture(scope="module")
def pios(image: Path) -> Iterator[Pios]:
    pios = Pios(image)
    yield pios
    pios.close()


# ---- words ----


@pytest.mark.parametrize("source, origin, block", PROGRAMS, ids=["lamps", "train", "odometer", "guard of two"])
def test_the_words_are_those_another_assembler_makes(source: str, origin: int, block: int, pios: Pios) -> None:
    words = assembled(source, origin)
    linked = [found for _, found in tables(IMAGE.with_suffix(".elf").read_bytes())[len(words)]]
    assert words in linked, [f"{word:04x}" for word in words]
    assert pios.blocks[block]["memory"][origin : origin + len(words)] == words  # and what the running image has loaded


def test_every_pio_program_of_the_image_is_among_them(pios: Pios) -> None:
    sizes = [n for n, found in tables(IMAGE.with_suffix(".elf").read_bytes()).items() for _ in found]
    assert sorted(sizes) == sorted(len(assembled(source)) for source, _, _ in PROGRAMS)
    used = [0, 0]
    for source, _, block in PROGRAMS:
        used[block] += len(assembled(source))
    assert [sum(word is not None for word in block["memory"]) for block in pios.blocks] == used


# ---- cycles ----


def compare(
    pios: Pios,
    block: int,
    index: int,
    *,
    start: int,
    cycles: int,
    tx: list[int] | None = None,
    inputs: list[int] | None = None,
    pins: int = 0,
    patches: dict[int, int] | None = None,
) -> list[list[Any]]:
    """Run one machine of the image in both emulators; every register equal after every cycle. Our trace."""
    machine, memory, raw = pios.machine(block, index), pios.memory(block), inputs or []
    for at, word in (patches or {}).items():
        memory[at] = word
    wrap_bottom, wrap_top = machine["execctrl"] >> 7 & 31, machine["execctrl"] >> 12 & 31
    out_base, out_count = machine["pinctrl"] & 31, machine["pinctrl"] >> 20 & 63
    set_base, set_count = machine["pinctrl"] >> 5 & 31, machine["pinctrl"] >> 26 & 7
    in_base = machine["pinctrl"] >> 15 & 31
    outputs = ((1 << out_count) - 1) << out_base | ((1 << set_count) - 1) << set_base
    ours = pios.trace(machine=machine, memory=memory, start=start, tx=tx or [], inputs=raw, pins=pins, cycles=cycles)
    moves_pins = any(word >> 13 == 5 and word >> 5 & 7 == 0 for word in memory)  # theirs moves to pin 0 on
    shift = out_base if moves_pins else 0

    def levels(cycle: int) -> int:
        """Inputs pass two flip-flops; theirs knows no base of inputs."""
        seen = raw[cycle - 2] if 2 <= cycle < len(raw) + 2 else 0
        return (seen >> in_base | seen << (32 - in_base) & 0xFFFFFFFF) & ~(outputs >> shift)

    state = State(program_counter=start, pin_values=pins >> shift, pin_directions=outputs >> shift)
    state.transmit_fifo.extend(tx or [])
    theirs = emulate(
        memory,
        stop_when=lambda _, state: state.clock >= cycles,
        initial_state=state,
        input_source=levels,
        shift_isr_right=False,
        shift_osr_right=bool(machine["shiftctrl"] >> 19 & 1),
        out_base=out_base - shift,
        out_count=out_count,
        set_base=set_base - shift,
        set_count=set_count,
        jmp_pin=(machine["execctrl"] >> 24) - in_base & 31,
        wrap_target=wrap_bottom,
        wrap_top=wrap_top,
    )
    for cycle, (_, after) in enumerate(theirs):
        pc, x, y, isr, osr, levels_now, waiting, pushed = ours[cycle]
        found = (
            after.program_counter,
            after.x_register,
            after.y_register,
            after.input_shift_register.contents,
            after.output_shift_register.contents,
            (after.pin_values << shift) & outputs,
            len(after.transmit_fifo),
            list(after.receive_fifo),
        )
        after.receive_fifo.clear()  # the DMA is faster
        assert found == (pc, x, y, isr, osr, levels_now & outputs, waiting, pushed), f"cycle {cycle}"
    return ours


def runs(trace: list[list[Any]], pin: int) -> list[tuple[int, int]]:
    """(level, cycles) of a pin over a trace."""
    found: list[tuple[int, int]] = []
    for row in trace:
        level = row[5] >> pin & 1
        if found and found[-1][0] == level:
            found[-1] = (level, found[-1][1] + 1)
        else:
            found.append((level, 1))
    return found


@pytest.mark.parametrize("machine, pin", [(0, 5), (1, 6)])
def test_trains_are_played_alike(pios: Pios, machine: int, pin: int) -> None:
    rng = random.Random(machine)
    lengths = [4, 4, 30, 5, 50, 50, 17, *(rng.randrange(4, 60) for _ in range(40))]
    tx = [(length - 4) << 1 | (i % 2 == 0) for i, length in enumerate(lengths)]
    trace = compare(pios, 1, machine, start=0, cycles=sum(lengths) + 30, tx=tx)
    assert [size for _, size in runs(trace, pin)[1:-1]] == lengths[:-1]  # one word is one level for so many ticks


GATE_AND_TRIGGER = 3 << 5
WATCH = LABELS["watch"]


@pytest.mark.parametrize("opens", [5, 6, 7, 8, 40])
def test_the_guard_cuts_alike_when_the_interlock_opens(pios: Pios, opens: int) -> None:
    inputs = [0] * opens + [1 << 7] * 6 + [0] * 60
    trace = compare(pios, 1, 3, start=WATCH, cycles=opens + 50, tx=[9, 9, 9], inputs=inputs, pins=GATE_AND_TRIGGER)
    for pin in (5, 6):
        [(_, on), (_, off)] = runs(trace, pin)
        assert opens + 3 <= on <= opens + 2 + 5 and off > 40  # two flip-flops, at most four cycles unseen, the cut


LEADS_TO_TWO = {WATCH: TWO_AT}  # jmp: as the firmware has it once two inputs are configured
BOTH_CLOSED = (
    1 << 13 | GATE_AND_TRIGGER << 13
)  # theirs reads its own outputs among the inputs: ours has them there, too


@pytest.mark.parametrize("opens", [*range(20, 26), 60, 61, 62])
@pytest.mark.parametrize("pin", [7, 13])
def test_the_guard_of_two_cuts_alike_whichever_input_opens(pios: Pios, pin: int, opens: int) -> None:
    inputs = [BOTH_CLOSED] * opens + [BOTH_CLOSED ^ 1 << pin] * 80
    trace = compare(
        pios,
        1,
        3,
        start=TWO_AT + 5,
        cycles=opens + 50,
        tx=[3, 9, 9],
        inputs=inputs,
        pins=GATE_AND_TRIGGER,
        patches=LEADS_TO_TWO,
    )
    for output in (5, 6):
        [(_, on), (_, off)] = runs(trace, output)
        unseen = 5 if pin == 7 else 13 + 3  # the second is sampled, and three cycles later judged
        assert opens + 3 <= on <= opens + 2 + unseen + 1 and off > 20


def test_the_guard_of_two_cuts_alike_when_its_credits_run_out(pios: Pios) -> None:
    credits = [7, 20, 3]
    trace = compare(
        pios,
        1,
        3,
        start=TWO_AT + 5,
        cycles=300,
        tx=credits,
        inputs=[BOTH_CLOSED] * 300,
        pins=GATE_AND_TRIGGER,
        patches=LEADS_TO_TWO,
    )
    lasted = 1 + sum(6 * (credit + 1) + 7 for credit in credits) + 5  # an old one's last step, each, finding none
    assert runs(trace, 5) == [(1, lasted), (0, 300 - lasted)]


@pytest.mark.parametrize("credits", [[], [7], [7, 20, 3]])
def test_the_guard_cuts_alike_when_its_credits_run_out(pios: Pios, credits: list[int]) -> None:
    trace = compare(pios, 1, 3, start=WATCH, cycles=200, tx=credits, inputs=[0] * 200, pins=GATE_AND_TRIGGER)
    lasted = 2 + sum(2 * (credit + 1) + 5 for credit in credits) + 4  # what x held, each credit, finding none
    assert runs(trace, 5) == [(1, lasted), (0, 200 - lasted)]


def test_the_odometers_transitions_are_pushed_alike(pios: Pios) -> None:
    rng = random.Random(3)
    inputs: list[int] = []
    levels = []
    for _ in range(60):
        levels.append(rng.choice([level for level in range(4) if not levels or level != levels[-1]]))
        inputs += [levels[-1] << 14 | rng.getrandbits(14)] * rng.randrange(12, 40)
    trace = compare(pios, 1, 2, start=len(assembled(TRAIN)), cycles=len(inputs), inputs=inputs)
    pushed = [word for row in trace for word in row[7]]
    assert pushed == [now for before, now in itertools.pairwise([0, *levels]) if now != before]


def test_the_turntables_steps_are_alike(pios: Pios) -> None:
    tx = [word for half in (5, 21, 33) for word in (half, half, half)]  # delay, width, level: one odd word
    trace = compare(pios, 0, 2, start=16, cycles=300, tx=tx)
    assert [size for level, size in runs(trace, 8) if level == 1] == [half + 2 for half in (5, 21, 33)]
