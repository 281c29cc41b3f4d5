"""Scenes in which subsystems meet: a train, a move, lamps, a preamble, the odometer, a measurement or an update, and at
drawn phases of them whatever ends them: interlock, silence, disarm, reset, a stalled loop, a pulled plug, a switch.

The wiring (which pins are inverted) is the board's, and stays for as many scenes as one board plays.
"""

import random
from dataclasses import replace

from annulus_pipe.controller import (
    CAMERA_TRIGGER_MIN_TICKS,
    FRAME_PERIOD_MIN_TICKS,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PREAMBLE_MAX,
    TURNTABLE_PERIOD_MIN_TICKS,
)
from annulus_pipe.link.messages import (
    LEVEL,
    RESET_MAGIC,
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstStop,
    CameraTrigger,
    Clear,
    Command,
    Commit,
    Image,
    Measure,
    Move,
    Ping,
    PolarityFlag,
    Preamble,
    Reset,
    Samples,
    Stage,
    Status,
    TurntableStop,
    Wiring,
)
from tools.attack import themes
from tools.attack.boards import MS, UART, US, USB, Edge
from tools.attack.kept import OPENS
from tools.attack.scenes import LAMPS, MICROWAVE, Scene, legal_config, odometer_steps, sync_falls, waveform
from tools.attack.updates import LEAST_CHUNKS, Update

SCENES_A_BOARD = 20
INTERLOCK = (PIN_INTERLOCK, PIN_INTERLOCK_ANTIVALENT)
CONTACTS = (*INTERLOCK, PIN_END_LOW, PIN_END_HIGH)
BOTH = LAMPS | MICROWAVE
ENDS = (
    "interlock",
    "bounce",
    "glimpse",
    "disarm",
    "lamps only",
    "stop train",
    "stop move",
    "switch",
    "stall",
    "commit",
    "preamble",
    "measure",
    "unplug",
    "replug",
    "rewire",
    "late clear",
)
KINDS = ("broken off", "early", "damaged", "foreign", "whole")  # of updates
NEAR = (0, 1, 50, 10 * US, 100 * US, 500 * US, 2 * MS)  # between two that meet


def wiring(seed: int, number: int) -> PolarityFlag:
    """Of the board that plays scene `number`; every fourth board's is as in the documents' pictures."""
    rng = random.Random(f"wiring/{seed}/{number // SCENES_A_BOARD}")
    return PolarityFlag(rng.choice((0, 63, rng.randrange(64), rng.randrange(64))))


def draw(seed: int, number: int, board: str) -> Scene:
    """Product `number` of an attack."""
    rng = random.Random(f"products/{seed}/{number}")
    native = board == "native"
    line = USB if rng.random() < (0.25 if native else 0.06) else UART
    config = legal_config(rng, rng.randrange(1, 256), rng.randrange(2 * MS, 12 * MS if rng.random() < 0.3 else 4 * MS))
    config = replace(config, host_timeout=rng.choice((0, 50, 80, 5000)))
    updates = rng.random() < 0.15
    outputs = ArmFlag(0) if updates else rng.choice((BOTH, BOTH, BOTH, MICROWAVE, LAMPS))
    falls = sync_falls(rng, config, rng.randrange(8, 80), long_pauses=False)
    end = falls[-1] + rng.randrange(2 * config.frame_period)
    if updates:
        end = max(end, 300 * MS)
    resets = rng.random() < 0.15
    if resets:
        end = rng.randrange(falls[len(falls) // 2], end)
        falls = [fall for fall in falls if fall < end]
    steps = odometer_steps(rng, min(end, 400 * MS), 700)
    chips = "".join(rng.choice(("1", "10", "100")) for _ in range(rng.randrange(1, 40)))
    scene = Scene(line, config, outputs, falls, waveform(rng, falls, steps), [], end, chips, steps, level=LEVEL)
    scene.trigger = camera_trigger(rng, config)
    scene.antivalent = rng.random() < 0.5
    scene.preamble = Preamble(rng.choice((0, 3, PREAMBLE_MAX)), rng.choice((0, 1, 3)), 0)
    scene.turntable = themes.turntable(rng)
    keep_awake(scene)
    if updates:
        update(rng, scene, native)
    else:
        for _ in range(rng.choice((1, 1, 2, 3))):
            meeting(rng, scene, rng.choice((rng.randrange(end), rng.choice(falls))), native)
    if resets:
        scene.resets = True
        scene.actions.append((end - 1, "send", line, Reset(magic=RESET_MAGIC)))
        scene.actions = [action for action in scene.actions if action[0] < end]
        scene.inputs = [edge for edge in scene.inputs if edge[0] < end or edge[1] not in CONTACTS or closes(edge)]
        scene.end += rng.choice((10 * US, MS, 3 * MS))
    elif rng.random() < 0.15:
        timeout = (config.host_timeout or 500) * MS
        if timeout < end:
            scene.actions = themes.silence(rng, scene.actions, timeout, end)
    scene.actions.sort(key=lambda action: action[0])
    scene.inputs.sort(key=lambda edge: edge[0])
    return scene


def camera_trigger(rng: random.Random, config: Stage) -> tuple[int, int]:
    """Width and delay: none, of the controller's own clock, or begun by the sync input; room for it."""
    least = CAMERA_TRIGGER_MIN_TICKS
    most = FRAME_PERIOD_MIN_TICKS - least
    width = rng.choice((0, 0, least, most, rng.randrange(least, most)))
    earliest = config.frame_period - config.frame_period * config.tolerance // 1000
    if width == 0 or earliest < 4 * least or rng.random() < 0.6:
        return width, 0
    width = min(width, earliest - 2 * least)
    return width, rng.randrange(least, earliest - least - width + 1)


def keep_awake(scene: Scene) -> None:
    timeout = (scene.config.host_timeout or 500) * MS
    step = max(timeout // 4, min(timeout // 2, 25 * MS))
    scene.actions += [(tick, "send", scene.line, Ping()) for tick in range(0, scene.end, step)]


def burst_across(rng: random.Random, chips: str) -> Burst:
    """A train of some 10 to 50 ms, at the limit of duty or far from it."""
    code = rng.choice((BurstCode.UPLOADED, BurstCode.SINGLE, BurstCode.MPSL25_STUFFED))
    ones = {BurstCode.UPLOADED: chips.count("1"), BurstCode.SINGLE: 1, BurstCode.MPSL25_STUFFED: 11}[code]
    run = max(map(len, chips.split("0"))) if code == BurstCode.UPLOADED else 1
    chip = rng.choice((50, max(30, 3000 // run), 30))
    period = max(ones * chip * 20, 60 * chip, 600) * rng.choice((1, 1, 3))
    offset = rng.choice((0, period - 100 if period > 100 else 0, -10))
    return Burst(code, chip, max(1, min(2000, rng.randrange(10 * MS, 50 * MS) // period)), period, offset)


def meeting(rng: random.Random, scene: Scene, moment: int, native: bool) -> None:
    """All that can run runs, and several things end it at one moment; then it is begun anew."""
    line, actions = scene.line, scene.actions

    def send(at: int, *commands: Command) -> None:
        actions.extend((max(0, at) + i, "send", line, command) for i, command in enumerate(commands))

    def near() -> int:
        return max(0, moment + rng.choice((-1, 1)) * rng.choice(NEAR))

    period = rng.choice((TURNTABLE_PERIOD_MIN_TICKS, rng.randrange(TURNTABLE_PERIOD_MIN_TICKS, 60_000)))
    far = rng.choice((-themes.FARTHEST, themes.FARTHEST, rng.randrange(-300, 300)))
    before = moment - rng.randrange(MS, 12 * MS)
    first = [burst_across(rng, scene.chips), Move(far, period, rng.randrange(2))]
    rng.shuffle(first)
    send(before, *first)
    if rng.random() < 0.5:
        send(near(), Preamble(rng.choice((1, 5, PREAMBLE_MAX)), rng.choice((0, 1)), 1))
    for what in rng.sample(ENDS, rng.randrange(1, 5)):
        end_by(rng, scene, what, near(), native, send)
    after = moment + rng.choice((200 * US, 3 * MS, 20 * MS))
    send(after, Status(), Clear(), Arm(scene.outputs), burst_across(rng, scene.chips), Move(-far, period, 0))


def closes(edge: Edge) -> bool:
    return edge[2] != OPENS.get(edge[1], 1)


def opening(rng: random.Random, scene: Scene, at: int, shut: int, one_only: int | None = None) -> None:
    """Of the interlock. With two inputs one may come later than the other, as a relay's contacts do, or, as from a wire
    that broke, alone; `one_only`: 0 the second, 1 the first, 2 both, together.
    """
    both = scene.antivalent
    skew = rng.choice((0, 5, 50, 10 * US, MS, 3 * MS, 7 * MS)) if one_only is None else 0
    alone = rng.choice((0, 1, 2, 2)) if one_only is None else one_only
    late = rng.choice((0, 1))
    for number, pin in enumerate(INTERLOCK):
        if (pin == PIN_INTERLOCK and not (both and alone == 0)) or (pin != PIN_INTERLOCK and both and alone != 1):
            begin = at + (skew if number == late else 0)
            end = max(begin + 1, shut + (rng.choice((0, skew)) if number == late else 0))
            scene.inputs += [(begin, pin, OPENS[pin]), (end, pin, 1 - OPENS[pin])]


def end_by(rng: random.Random, scene: Scene, what: str, at: int, native: bool, send) -> None:  # type: ignore[no-untyped-def]
    inputs, generation = scene.inputs, scene.config.generation % 255 + 1
    opens = all(pin not in INTERLOCK for _, pin, _ in inputs)  # two bounces would interleave
    match what:
        case "interlock" if opens:
            shut = at + rng.choice((50, 10 * US, MS, 15 * MS))
            opening(rng, scene, at, shut)
            send(rng.randrange(at, shut), Clear(), Arm(scene.outputs), Status())
        case "bounce" if opens:
            for _ in range(rng.randrange(2, 8)):
                length = rng.choice((5, 50, 10 * US, 200 * US, MS))
                opening(rng, scene, at, at + length, rng.randrange(3) if scene.antivalent else 1)
                at += length + rng.choice((5, 50, 10 * US, MS))
            send(at - rng.randrange(MS), Clear(), Arm(scene.outputs))
        case "glimpse" if opens:
            opening(rng, scene, at, at + rng.randrange(1, 25 if scene.antivalent else 5), rng.randrange(3))
        case "disarm":
            send(at, Arm(ArmFlag(0)))
            if rng.random() < 0.5:
                send(at + rng.choice((1, 300 * US)), Arm(scene.outputs))
        case "lamps only":
            send(at, Arm(LAMPS), Arm(BOTH), Arm(MICROWAVE), Arm(scene.outputs))
        case "stop train":
            send(at, BurstStop(), burst_across(rng, scene.chips))
        case "stop move":
            send(at, TurntableStop(), Move(rng.randrange(-300, 300), 20_000, 0))
        case "switch":
            pin = rng.choice((PIN_END_LOW, PIN_END_HIGH))
            if all(which != pin for _, which, _ in inputs):
                inputs += [(at, pin, 1), (at + rng.choice((50, 10 * US, 5 * MS)), pin, 0)]
        case "stall":
            scene.actions.append((at, "stall", 0, rng.choice((MS, 3 * MS, 5 * MS, 30 * MS, rng.randrange(MS, 8 * MS)))))
        case "commit":
            period = rng.choice((scene.config.frame_period, rng.randrange(2 * MS, 12 * MS)))
            width = CameraTrigger(generation, CAMERA_TRIGGER_MIN_TICKS, 0)
            staged = [legal_config(rng, generation, period), Commit(generation)]
            send(at, *staged, *((width,) if rng.random() < 0.3 else ()), Wiring())
        case "preamble":
            send(at, Preamble(rng.randrange(PREAMBLE_MAX + 1), rng.randrange(3), rng.randrange(2)))
        case "measure":
            send(at, *measurement(rng))
        case "unplug" if scene.line == USB:
            scene.actions.append((at, "plug", USB, False))
        case "replug" if scene.line == USB:
            gone = 180 * MS if native else rng.choice((US, 10 * US, MS, 30 * MS))  # before it is a device again
            if rng.random() < 0.5 and not native:
                scene.actions.append((at, "vbus", USB, gone))
            else:
                scene.actions += [(at, "plug", USB, False), (at + gone, "plug", USB, True)]
        case "rewire":
            generation = generation % 255 + 1
            period = rng.choice((scene.config.frame_period, rng.randrange(2 * MS, 6 * MS)))
            new = legal_config(rng, generation, period)
            lasts = camera_trigger(rng, new) if not scene.trigger[0] or rng.random() < 0.6 else (0, 0)
            staged = [new, CameraTrigger(generation, *lasts), Commit(generation)]
            send(at, Arm(ArmFlag(0)), *staged, Wiring(), Arm(scene.outputs))
        case "late clear":
            send(at, Clear(), Status())


def measurement(rng: random.Random) -> list[Command]:
    look = Measure(rng.choice((0, 1, 500)), rng.choice((2, 3, 5, 8)), rng.randrange(2), rng.choice((2, 5, 7)), 0)
    return [look, Samples(rng.randrange(2), 0)]


def update(rng: random.Random, scene: Scene, native: bool) -> None:
    """The flash erases and writes while edges come and orders are refused; nothing is armed."""
    line, actions, end = scene.line, scene.actions, scene.end
    scene.erase = rng.choice((20, 45, 45, 120, 400)) * MS
    kind = rng.choice(KINDS if native or rng.random() < 0.2 else KINDS[:-1])  # the image's own takes 3 s
    if kind == "whole":
        scene.erase = rng.choice((20, 45)) * MS
    new = Update(kind, rng.choice((LEAST_CHUNKS, 130, 300)), rng.getrandbits(32))
    actions.append((rng.randrange(end // 3), "update", line, new))
    for _ in range(rng.randrange(8)):
        orders: list[Command] = [Arm(BOTH), Move(100, 20_000, 0), Status(), Image(), *measurement(rng), Clear()]
        actions.append((rng.randrange(end), "send", line, rng.choice(orders)))
    if rng.random() < 0.4:
        at = rng.randrange(end)
        scene.inputs += [(at, PIN_INTERLOCK, 1), (at + rng.choice((50, MS)), PIN_INTERLOCK, 0)]
