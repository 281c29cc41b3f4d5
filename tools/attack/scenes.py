"""What is done to a board: scenes of legal commands and pin waveforms, each drawn from its own seed and nothing else.

A scene begins and ends disarmed, with the interlock closed, so that it can also be played alone.
"""

import random
from dataclasses import dataclass, field, replace

from annulus_pipe.controller import (
    CHIPS_MAX,
    CODES,
    LAMP_WIDTH_MAX_TICKS,
    PIN_INTERLOCK,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_SYNC,
    PREAMBLE_MAX,
    TICKS_PER_US,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstStop,
    Clear,
    Command,
    Commit,
    Move,
    Pattern,
    Ping,
    Preamble,
    Reread,
    Stage,
    Status,
    Turntable,
)
from tools.attack import themes
from tools.attack.boards import MS, UART, USB, Edge

US = TICKS_PER_US
LAMPS, MICROWAVE = ArmFlag.LAMPS, ArmFlag.MICROWAVE
Action = tuple[int, str, int, object]  # tick from the scene's beginning, what, line, with what
QUADRATURE = ((1, 1), (0, 1), (0, 0), (1, 0))  # counting up


@dataclass(slots=True)
class Scene:
    """Ticks are from the scene's beginning, when it is configured and armed."""

    line: int
    config: Stage
    outputs: ArmFlag
    falls: list[int]
    inputs: list[Edge]
    actions: list[Action]
    end: int
    chips: str = ""  # of the uploaded pattern
    steps: list[tuple[int, int]] = field(default_factory=list)  # odometer: tick, +1 or -1
    turntable: Turntable | None = None  # what it is told to begin with
    preamble: Preamble | None = None  # and what preambles are to be like
    level: int = 1  # of the host
    trigger: tuple[int, int] = (0, 0)  # of cameras: how long each lasts, and how long after an edge; 0: its end is one
    erase: int = 0  # how long the flash takes for a sector
    resets: bool = False  # it ends with one
    antivalent: bool = False  # the interlock has its second input


def legal_config(rng: random.Random, generation: int, period: int) -> Stage:
    """Anything the controller's documents allow, the limits themselves among it."""
    tolerance = rng.choice((1, 20, 100, 300, 500, rng.randrange(1, 501)))
    readout = rng.choice((0, period // 5, rng.randrange(period // 2)))
    exposure = rng.choice((period, period - rng.randrange(period // 4)))
    closes = min(period - readout, period - period * tolerance // 1000)
    opens = period - exposure

    def flash() -> tuple[int, int]:
        room = min(LAMP_WIDTH_MAX_TICKS, period // 2, closes - opens)
        if room < 2 or rng.random() < 0.1:
            return rng.randrange(period), 0
        width = rng.choice((room, room // 2, room // 10, rng.randrange(2, room + 1)))
        width = max(2, width)
        delay = rng.choice((opens, closes - width, rng.randrange(opens, closes - width + 1)))
        return delay, width

    (projector_delay, projector_width), (led_delay, led_width) = flash(), flash()
    return Stage(
        generation=generation,
        ratio=rng.choice((0, 1, 4, 15)),
        frame_period=period,
        exposure=exposure,
        readout=readout,
        tolerance=tolerance,
        host_timeout=rng.choice((0, 50, 500, 5000)),
        projector_delay=projector_delay,
        projector_width=projector_width,
        led_delay=led_delay,
        led_width=led_width,
    )


def sync_falls(rng: random.Random, config: Stage, count: int, long_pauses: bool) -> list[int]:
    """Frames as cameras send them, and as they never should."""
    period = config.frame_period
    earliest = period - period * config.tolerance // 1000
    kind = rng.choice(("steady", "steady", "early", "glitches", "storm", "rate", "pause", "any"))
    rate = rng.uniform(0.4, 1.8)
    at = rng.randrange(2 * MS)
    falls: list[int] = []
    while len(falls) < count:
        falls.append(at)
        step = period + rng.randrange(-100, 101)
        if kind == "early":
            step = earliest + rng.randrange(20, 2000)
        elif kind == "glitches" and rng.random() < 0.5:
            for _ in range(rng.randrange(1, 4)):
                falls.append(falls[-1] + rng.randrange(40 * US, 60 * US))
        elif kind == "storm" and rng.random() < 0.1:
            for _ in range(min(40, count)):
                falls.append(falls[-1] + rng.randrange(40 * US, 200 * US))
        elif kind == "rate" and len(falls) > count // 2:
            step = int(period * rate)
        elif kind == "pause" and rng.random() < 0.05:
            step = int(period * rng.uniform(2, 8))
            if long_pauses and rng.random() < 0.2:
                step = rng.randrange(2000 * MS, 60_000 * MS)
        elif kind == "any":
            step = rng.randrange(period // 8, 2 * period)
        at = max(at + step, falls[-1] + 40 * US)
    return falls


def odometer_steps(rng: random.Random, end: int, most: int) -> list[tuple[int, int]]:
    kind = rng.choice(("rest", "forward", "reverse", "jerk", "bounce"))
    if kind == "rest":
        return []
    gap = rng.choice((5 * US, 10 * US, 100 * US, max(5 * US, end // most)))
    steps, at, way = [], rng.randrange(max(1, end // 2)), -1 if kind == "reverse" else 1
    for i in range(rng.randrange(1, most)):
        if kind == "bounce":
            way = rng.choice((-1, 1))
        elif kind == "jerk" and i == most // 2:
            way = -way
        steps.append((at, way))
        at += gap + rng.randrange(US)
    return [step for step in steps if step[0] < end]


def legal_burst(rng: random.Random, uploaded: str) -> Burst | None:
    """A train that ends within some 100 ms; half of them at the very limit of duty."""
    code = rng.choice([*BurstCode])
    chips = uploaded if code == BurstCode.UPLOADED else list(CODES.values())[code - 1]
    runs = [run for run in chips.split("0") if run]
    if not runs:
        return None
    longest, shortest = max(map(len, runs)), min(map(len, runs))
    low, high = max(10, -(-30 // shortest)), min(3000, 3000 // longest)
    if low > high:
        return None
    chip = rng.choice((low, high, 50 if low <= 50 <= high else low, rng.randrange(low, high + 1)))
    least = max(chips.count("1") * chip * 20, (len(chips) + 1) * chip, 200)
    period = rng.choice((least, least + rng.randrange(1, 100 * US), least * 3))
    before, after = -(period - len(chips) * chip), period - 100
    offset = rng.choice((0, before, after, rng.randrange(before, after + 1)))
    repeat = rng.choice((1, 1, 2, max(1, min(65535, 40, 80 * MS // period))))
    return Burst(code=code, chip=chip, repeat=repeat, period=period, trigger_offset=offset)


def draw(seed: int, number: int, board: str) -> Scene:
    """Scene `number` of an attack."""
    rng = random.Random(f"{seed}/{number}")
    native = board == "native"
    line = USB if rng.random() < (0.2 if native else 0.02) else UART
    longest = 100 * MS if native and rng.random() < 0.1 else 12 * MS
    period = rng.randrange(2 * MS, longest)
    config = legal_config(rng, rng.randrange(1, 256), period)
    if rng.random() < 0.2:
        config = replace(config, host_timeout=rng.choice((50, 50, 80)))  # short enough for a silence in one scene
    outputs = rng.choice((LAMPS, LAMPS, LAMPS | MICROWAVE, LAMPS | MICROWAVE, MICROWAVE, ArmFlag(0)))
    falls = sync_falls(rng, config, rng.randrange(5, 120 if native else 60), native and line == UART)
    end = falls[-1] + rng.randrange(4 * period)
    steps = odometer_steps(rng, min(end, 2000 * MS), 1500 if native else 700)
    chips = "".join(rng.choice(("1", "10", "100", "0", "1000")) for _ in range(rng.randrange(1, 60)))[:CHIPS_MAX]
    scene = Scene(line, config, outputs, falls, waveform(rng, falls, steps), [], end, chips, steps)
    add_commands(rng, scene)
    add_mishaps(rng, scene, native)
    add_themes(rng, scene)
    add_preambles(rng, scene)
    scene.actions.sort(key=lambda action: action[0])
    scene.inputs.sort(key=lambda edge: edge[0])
    turns = any(isinstance(action[-1], Move | Turntable) for action in scene.actions)
    new = turns or scene.turntable or scene.preamble  # only then is a stop, or a preamble, told
    scene.level = 2 if new else rng.choice((1, 2))
    return scene


def waveform(rng: random.Random, falls: list[int], steps: list[tuple[int, int]]) -> list[Edge]:
    edges: list[Edge] = []
    for i, fall in enumerate(falls):
        room = falls[i + 1] - fall if i + 1 < len(falls) else 100 * US
        low = rng.randrange(20, min(room - 20, 100 * US))
        edges += [(fall, PIN_SYNC, 0), (fall + low, PIN_SYNC, 1)]
    count = 0
    for tick, way in steps:
        (a, b), (new_a, new_b) = QUADRATURE[count % 4], QUADRATURE[(count + way) % 4]
        count += way
        edges.append((tick, PIN_ODOMETER_A, new_a) if a != new_a else (tick, PIN_ODOMETER_B, new_b))
        assert (a, b) != (new_a, new_b)
    while count % 4:  # the next scene begins at rest
        (a, _), (new_a, new_b) = QUADRATURE[count % 4], QUADRATURE[(count - 1) % 4]
        tick = steps[-1][0] + 10 * US
        steps.append((tick, -1))
        edges.append((tick, PIN_ODOMETER_A, new_a) if a != new_a else (tick, PIN_ODOMETER_B, new_b))
        count -= 1
    return edges


def add_commands(rng: random.Random, scene: Scene) -> None:
    config, end = scene.config, scene.end
    timeout = (config.host_timeout or 500) * MS
    tick = 0
    while tick < end:
        scene.actions.append((tick, "send", scene.line, Ping()))
        tick += max(timeout // 4, min(timeout // 2, 25 * MS))
    generation = config.generation
    near = [*scene.falls, *(rng.randrange(end) for _ in scene.falls)]

    def some_tick() -> int:
        """Often where it hurts: just before or after an edge."""
        return max(0, min(end - 1, rng.choice(near) + rng.randrange(-500 * US, 200 * US)))

    for _ in range(rng.randrange(0, 12)):
        tick, what = some_tick(), rng.random()
        commands: list[Command] = []
        if what < 0.2:
            generation = generation % 255 + 1
            period = config.frame_period if rng.random() < 0.7 else rng.randrange(2 * MS, 12 * MS)
            commands = [legal_config(rng, generation, period), Commit(generation=generation)]
        elif what < 0.35:
            commands = [Arm(outputs=rng.choice((ArmFlag(0), LAMPS, MICROWAVE, LAMPS | MICROWAVE)))]
            if rng.random() < 0.5:
                commands.append(Arm(outputs=scene.outputs))
        elif what < 0.65:
            bursts = [legal_burst(rng, scene.chips) for _ in range(rng.randrange(1, 4))]
            commands = [burst for burst in bursts if burst]
        elif what < 0.72:
            commands = [BurstStop()]
        elif what < 0.8:
            commands = [Status(), Reread(first=rng.randrange(200), count=rng.randrange(1, 30))]
            if rng.random() < 0.5:
                commands.append(Reread(first=rng.randrange(200), count=rng.randrange(1, 30)))
        elif what < 0.85:
            commands = [Clear(), Arm(outputs=scene.outputs)]
        elif what < 0.9:
            position, step = rng.randrange(-300, 300), rng.randrange(10_000, 100_000)
            commands = [Move(position=position, period=step, hold=rng.randrange(2))]
        elif what < 0.93:
            scene.actions.append((tick, "noise", scene.line, rng.randbytes(rng.randrange(1, 90)) + b"\0"))
        else:  # wrong orders, each to be refused and nothing else
            bits = int("".join(rng.choice("01") for _ in range(32)), 2)
            commands = [
                rng.choice(
                    (
                        Commit(generation=rng.randrange(256)),
                        legal_config(rng, generation, rng.randrange(2 * MS, 12 * MS)),
                        Pattern(length=32, chips=bits.to_bytes(32, "little")),
                        Burst(code=BurstCode.SINGLE, chip=4000, repeat=1, period=100, trigger_offset=0),
                    )
                )
            ]
        scene.actions += [(tick + i, "send", scene.line, command) for i, command in enumerate(commands)]


def add_themes(rng: random.Random, scene: Scene) -> None:
    if rng.random() < 0.15:
        scene.turntable = themes.turntable(rng)
        if rng.random() < 0.4:  # nothing but the turntable is live
            scene.outputs = ArmFlag(0)
            scene.actions = [action for action in scene.actions if not isinstance(action[3], Arm)]
        scene.actions += themes.moves(rng, scene.line, min(scene.end, 600 * MS), scene.outputs, scene.inputs)
    if scene.outputs & MICROWAVE and rng.random() < 0.15:
        scene.actions += themes.bursts(rng, scene.line, scene.end)
    timeout = (scene.config.host_timeout or 500) * MS
    if timeout < scene.end and rng.random() < 0.4:
        scene.actions = themes.silence(rng, scene.actions, timeout, scene.end)


def add_preambles(rng: random.Random, scene: Scene) -> None:
    if rng.random() < 0.5:
        return

    def some(now: int) -> Preamble:
        return Preamble(rng.choice((0, 1, 5, 15, PREAMBLE_MAX)), rng.choice((0, 1, 2, 5)), now)

    scene.preamble = some(0)
    for _ in range(rng.randrange(6)):
        tick = max(0, min(scene.end - 1, rng.choice(scene.falls) + rng.randrange(-500 * US, 200 * US)))
        scene.actions.append((tick, "send", scene.line, some(rng.randrange(2))))
    if rng.random() < 0.2:  # wrong, and to be refused
        scene.actions.append((rng.randrange(scene.end), "send", scene.line, Preamble(PREAMBLE_MAX + 1, 1, 1)))


def add_mishaps(rng: random.Random, scene: Scene, native: bool) -> None:
    end = scene.end
    if rng.random() < 0.15:
        at = rng.randrange(end)
        for _ in range(rng.randrange(1, 6)):  # a contact that bounces
            length = rng.choice((50, 10 * US, MS, rng.randrange(50, 5 * MS)))
            scene.inputs += [(at, PIN_INTERLOCK, 1), (at + length, PIN_INTERLOCK, 0)]
            at += length + rng.randrange(50, MS)
    if rng.random() < 0.15:
        longest = 150 * MS if rng.random() < 0.05 else rng.choice((MS, 10 * MS, 60 * MS))
        scene.actions.append((rng.randrange(end), "stall", 0, rng.randrange(longest // 10, longest)))
    if scene.line == USB and rng.random() < 0.5:
        scene.actions.append((rng.randrange(end), "plug", USB, False))
    elif native and rng.random() < 0.1:  # somebody looks on over the other line
        at = rng.randrange(end)
        scene.actions += [(at, "plug", USB, True), (at + MS, "send", USB, Status()), (at + 30 * MS, "plug", USB, False)]
