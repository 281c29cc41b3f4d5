"""What an engineer does with one controller at a time: `annulus head`. Each verb opens the port, acts and leaves
the outputs as it says, also when interrupted.
"""

import time
from collections.abc import Callable
from typing import Protocol, TypeVar

from annulus_pipe.controller import CHIPS_MAX, CODES, HOST_TIMEOUT_DEFAULT_MS, TICK_HZ, TICKS_PER_US, TURNTABLE_LEAD_MS
from annulus_pipe.link.client import Client
from annulus_pipe.link.hardware import hardware_fields
from annulus_pipe.link.messages import (
    COMMANDS,
    Arm,
    ArmFlag,
    BootCause,
    Burst,
    BurstCode,
    BurstDone,
    BurstReply,
    Clear,
    ClearReply,
    Commit,
    Configuration,
    ConfigurationReply,
    Crash,
    CrashKind,
    CrashReply,
    Edge,
    Fault,
    FaultCode,
    Health,
    HealthReply,
    Image,
    ImageReply,
    ImageWhy,
    Move,
    Pattern,
    Polarity,
    Slides,
    Stage,
    StageReply,
    StateFlag,
    Status,
    StatusReply,
    StopCause,
    SyncLost,
    Turntable,
    TurntableDone,
    TurntableFlag,
    TurntableReply,
    TurntableStop,
    TurntableStopped,
    TurntableStopReply,
    Wiring,
    WiringReply,
)
from annulus_pipe.link.pins import AS_WIRED, Pins, pins_text
from annulus_pipe.link.problems import LATCHING, configuration_problem, too_old
from annulus_pipe.link.session import EventReceived, EventsLost, Rebooted
from annulus_pipe.vocabulary import AnnulusError, Lamp

KEEP_ALIVE_S = 0.1  # well inside the shortest sensible host timeout
READ_AGAIN_S = 0.01
TRAIN_SLACK_S = 1.0
FORCE_SLACK_S = 0.5  # beyond the frames of a cycle, for a commit to take force
TURNTABLE_BUSY_S = 60.0
U32 = 2**32
U16_MAX = 2**16 - 1

Awaited = TypeVar("Awaited", BurstDone, TurntableDone)


def counted(value: int) -> int | str:
    """A counter of 16 bits, which stops at its end."""
    return value if value < U16_MAX else f"{U16_MAX} or more"


def status(port: str) -> dict[str, object]:
    """Identity, state, counters, configuration and the last crash, with units in the names; null: firmware too old."""
    with Client(port, diagnostics=True) as client:
        who = client.identity
        reply = client.request(Status())
        assert isinstance(reply, StatusReply)
        info = client.session.info
        return {
            "board": text_of(who.board),
            "serial_number": text_of(info.serial) if info else None,
            "firmware": text_of(who.git),
            "version": f"{info.major}.{info.minor}.{info.patch}" if info else None,
            "level": info.level if info else 1,
            "protocol": who.protocol,
            "schema": f"{who.schema:08x}",
            "boot": who.boot,
            "boot_cause": BootCause(who.cause).name.lower(),
            "state": _flags(reply.state),
            "fault": reply.fault.name.lower(),
            "generation": reply.generation,
            "edges": reply.edges,
            "edges_rejected": reply.rejected,
            "frame_period_us": reply.period / TICKS_PER_US,
            "odometer_counts": reply.odometer,
            "turntable_steps": reply.turntable,
            "bad_frames": counted(reply.bad_frames),
            "late_flashes": counted(reply.late),
            "event_overruns": counted(reply.overruns),
            "longest_round_us": info.round_longest / TICKS_PER_US if info else None,
            **_image_fields(client),
            **_configuration_fields(client),
            **_wiring_fields(client),
            **_crash_fields(client),
            **_health(client),
            **hardware_fields(client),
        }


def _image_fields(client: Client) -> dict[str, object]:
    """Which application runs, and whether the next start would find it."""
    found = client.request(Image()) if client.session.knows(Image) else None
    if not isinstance(found, ImageReply):
        return {"image_slot": None, "image": None, "image_in_flash": None}
    if found.why is ImageWhy.GIVEN_UP:
        line = "the newer one was started three times and no host understood it: went back to this"
    elif found.why is ImageWhy.DAMAGED:
        line = "the newer one is damaged in flash: went back to this. Flash again"
    else:
        line = f"on trial, start {found.starts} of 3" if found.starts else "confirmed"
    return {"image_slot": found.slot, "image": line, "image_in_flash": found.flash.name.lower()}


def _configuration_fields(client: Client) -> dict[str, object]:
    """What is in force; null without one."""
    found = client.request(Configuration()) if client.session.knows(Configuration) else None
    if not isinstance(found, ConfigurationReply) or found.generation == 0:
        return {"configuration": None}
    us = TICKS_PER_US
    return {
        "configuration": f"{found.crc:04x}",
        "ratio": found.ratio,
        "configured_period_us": found.frame_period / us,
        "exposure_us": found.exposure / us,
        "readout_us": found.readout / us,
        "tolerance_permille": found.tolerance,
        "host_timeout_ms": found.host_timeout or HOST_TIMEOUT_DEFAULT_MS,
        "projector_delay_us": found.projector_delay / us,
        "projector_width_us": found.projector_width / us,
        "led_delay_us": found.led_delay / us,
        "led_width_us": found.led_width / us,
    }


def _wiring_fields(client: Client) -> dict[str, object]:
    """Pins that are inverted, and outputs that are driven; null: firmware too old."""
    found = client.request(Wiring()) if client.session.knows(Wiring) else None
    if not isinstance(found, WiringReply):
        return {"pins_inverted": None, "pins_driven": None, "camera_trigger_us": None, "camera_trigger_delay_us": None}
    return {
        "pins_inverted": pins_text(found.inverted),
        "pins_driven": pins_text(found.driven),
        "camera_trigger_us": found.camera_trigger / TICKS_PER_US,
        "camera_trigger_delay_us": found.camera_trigger_delay / TICKS_PER_US,
    }


def _crash_fields(client: Client) -> dict[str, object]:
    """The last end that nobody asked for, in one line, and what to do with it."""
    last = client.request(Crash()) if client.session.knows(Crash) else None
    if not isinstance(last, CrashReply):
        return {"boots_since_power_on": None, "crashes_since_power_on": None, "crash": None, "crash_pc": None}
    return {
        "boots_since_power_on": counted(last.boots),
        "crashes_since_power_on": counted(last.crashes),
        "crash": _crash_line(last) if last.kind is not CrashKind.NONE else None,
        "crash_pc": f"{last.pc:#010x}" if last.pc else None,
    }


def _crash_line(last: CrashReply) -> str:
    doing = f", last command {COMMANDS[last.command].__name__.lower()}" if last.command in COMMANDS else ""
    todo = (
        f"; in a checkout: addr2line -fe firmware/build/annulus.elf {last.pc:#x} {last.lr & ~1:#x}" if last.pc else ""
    )
    return (
        f"{last.kind.name.lower().replace('_', ' ')} in boot {last.boot} of {last.boots},"
        f" {last.tick / TICK_HZ:.3f} s (modulo 42.9 s) after it began, part {last.part.name.lower()} of round"
        f" {last.rounds}{doing}{todo}"
    )


def _health(client: Client) -> dict[str, object]:
    """What went wrong at the board."""
    found = client.request(Health()) if client.session.knows(Health) else None
    if not isinstance(found, HealthReply):
        return dict.fromkeys(("odometer_lost_counts", "odometer_impossible_counts", "edges_dropped", "usb_hangs"))
    return {
        "odometer_lost_counts": found.odometer_lost,
        "odometer_impossible_counts": found.odometer_impossible,
        "edges_dropped": found.edges_dropped,
        "usb_hangs": found.usb_hangs,
    }


def configure(port: str, stage: Stage, pins: Pins | None = None) -> dict[str, object]:
    """Stage, validate, commit. `pins` None: as they are in force. AnnulusError with the controller's reason when it
    refuses.
    """
    with Client(port) as client:
        reply = client.request(stage)
        assert isinstance(reply, StageReply)
        if pins is not None and client.session.knows(Polarity):
            client.request(pins.polarity(stage.generation))
            client.request(pins.trigger(stage.generation))
            if client.session.knows(Slides):
                client.request(pins.shared(stage.generation))
            elif pins.slides > 1:
                raise AnnulusError(f"{port}: {too_old(Slides)}")
        elif pins not in (None, AS_WIRED):
            raise AnnulusError(f"{port}: {too_old(Polarity)}")
        client.request(Commit(stage.generation))
        verified = _verify(client, port, stage)
        return {
            "generation": reply.generation,
            "window_opens_us": reply.window_open / TICKS_PER_US,
            "window_closes_us": reply.window_close / TICKS_PER_US,
            "read_back": verified,
        }


def _verify(client: Client, port: str, stage: Stage) -> bool:
    """What is in force is what was asked for, or AnnulusError. False: the firmware is too old to be asked.

    While the lamps are armed it takes force at the next slot 0 only, after as many frames as a cycle has.
    """
    if not client.session.knows(Configuration):
        return False
    end = client.now_s() + FORCE_SLACK_S + (stage.ratio + 1) * stage.frame_period / TICK_HZ
    while True:
        found = client.request(Configuration())
        assert isinstance(found, ConfigurationReply)
        problem = configuration_problem(found, stage)
        if not problem:
            return True
        if client.now_s() > end or found.generation == stage.generation:
            raise AnnulusError(f"{port}: {problem}")
        client.poll(KEEP_ALIVE_S)


def disarm(port: str) -> None:
    with Client(port, diagnostics=True) as client:
        client.request(Arm(ArmFlag(0)))


def clear(port: str) -> str:
    """The fault that was latched. AnnulusError while its cause lasts."""
    with Client(port, diagnostics=True) as client:
        before = client.request(Status())
        after = client.request(Clear())
        assert isinstance(before, StatusReply) and isinstance(after, ClearReply)
        if after.fault is not FaultCode.NONE:
            raise AnnulusError(f"{port}: {after.fault.name.lower()} is still latched, expected its cause to be gone")
        return before.fault.name.lower()


def hold_armed(port: str, seconds: float, say: Callable[[str], None]) -> None:
    """Arm the lamps, feed the controller, disarm at the end or at Ctrl-C; `seconds` 0 waits for Ctrl-C.

    Raises AnnulusError on a latching fault or a restart of the controller.
    """
    with Client(port) as client:
        client.request(Arm(ArmFlag.LAMPS))
        say(f"armed{f' for {seconds:g} s' if seconds else ', Ctrl-C disarms'}")
        lamps = dict.fromkeys(Lamp, 0)
        lost = 0
        end = time.monotonic() + (seconds or float("inf"))
        try:
            while (now := time.monotonic()) < end:
                client.keep_alive()
                for happening in client.poll(min(KEEP_ALIVE_S, end - now)):
                    if isinstance(happening, EventReceived) and isinstance(happening.event, Edge):
                        lamps[happening.event.lamp] += 1
                    elif isinstance(happening, EventReceived) and isinstance(happening.event, SyncLost):
                        say(f"frame sync lost after edge {happening.event.last_edge}")
                    elif isinstance(happening, EventsLost):
                        lost += happening.count
                    _raise_on_fault(port, happening)
        except KeyboardInterrupt:
            pass
        finally:
            client.ask(Arm(ArmFlag(0)))
        flashes = ", ".join(f"{count} {lamp.name.lower()}" for lamp, count in lamps.items())
        say(f"disarmed; edges: {flashes}; events lost: {lost}")


def fire_burst(port: str, pattern: Pattern | None, burst: Burst) -> dict[str, object]:
    """Upload `pattern` if there is one, arm the microwave, fire, wait for the end of the train, disarm.

    Raises AnnulusError for a refusal (interlock, limits), or a fault that cut the train off.
    """
    with Client(port) as client:
        if pattern is not None:
            client.request(pattern)
        reply, done = send_train(client, port, burst)
    return {
        "chips": reply.length,
        "chip_us": burst.chip / TICKS_PER_US,
        "bursts": done.done,
        "period_us": burst.period / TICKS_PER_US,
        "train_us": (done.tick - reply.start) % U32 / TICKS_PER_US,
    }


class BurstTrain(Protocol):
    """Bursts as they are to be sent, in ticks; thermoacoustic.codes has one that knows the limits."""

    @property
    def chip_ticks(self) -> int: ...

    @property
    def repeat(self) -> int: ...

    @property
    def period_ticks(self) -> int: ...

    @property
    def trigger_offset_ticks(self) -> int: ...


def train_messages(code: str, train: BurstTrain) -> tuple[Pattern | None, Burst]:
    """A train on the wire, and the pattern to upload before it if the code is a text of 0 and 1, none built in."""
    pattern = None if code in CODES else _pattern(code)
    number = BurstCode.UPLOADED if pattern else BurstCode[code.upper().replace("-", "_")]
    return pattern, Burst(number, train.chip_ticks, train.repeat, train.period_ticks, train.trigger_offset_ticks)


def send_train(client: Client, port: str, burst: Burst) -> tuple[BurstReply, BurstDone]:
    """Arm the microwave, fire, wait for the end, disarm whatever happens; and return once the next may begin.

    Raises AnnulusError for a refusal, a fault, or a train cut short.
    """
    client.request(Arm(ArmFlag.MICROWAVE))
    try:
        reply = client.request(burst)
        assert isinstance(reply, BurstReply)
        done = _wait_for(BurstDone, client, port, burst.repeat * burst.period / TICK_HZ + TRAIN_SLACK_S)
    finally:
        client.ask(Arm(ArmFlag(0)))
    if done.fault is not FaultCode.NONE or done.done != burst.repeat:
        raise AnnulusError(f"{port}: {done.done} of {burst.repeat} bursts sent, cut off by {done.fault.name.lower()}")
    paid = reply.start + burst.repeat * burst.period + reply.length * burst.chip  # protocol/README.md, Microwave
    time.sleep(max(0, ticks_between(done.tick, paid)) / TICK_HZ)
    return reply, done


def status_of(client: Client) -> StatusReply:
    reply = client.request(Status())
    assert isinstance(reply, StatusReply)
    return reply


def require_no_fault(client: Client, port: str) -> None:
    """AnnulusError where one is latched."""
    fault = status_of(client).fault
    if fault is not FaultCode.NONE:
        raise AnnulusError(
            f"{port}: fault {fault.name.lower()} is latched; once its cause is gone, "
            "`annulus head clear` with this port clears it"
        )


def move_turntable(client: Client, port: str, position: int, step_us: float, *, hold: bool) -> None:
    """To an absolute position in steps, and wait until it stands. `hold` keeps the motor powered afterwards."""
    end = time.monotonic() + TURNTABLE_BUSY_S
    while StateFlag.TURNTABLE_MOVING in (before := status_of(client)).state:  # somebody's earlier move
        if time.monotonic() > end:
            raise AnnulusError(f"{port}: the turntable still moves after {TURNTABLE_BUSY_S:g} s, expected it to stand")
        client.poll(KEEP_ALIVE_S)
    if before.turntable == position and hold:
        return
    client.request(Move(position, round(step_us * TICKS_PER_US), int(hold)))
    steps_s = abs(position - before.turntable) * step_us * 1e-6
    patience_s = 1e-3 * TURNTABLE_LEAD_MS + steps_s + TRAIN_SLACK_S
    done = _wait_for(TurntableDone, client, port, patience_s, lambda: is_moving(client))
    if done.position != position:
        raise AnnulusError(f"{port}: the turntable stopped at step {done.position}, expected {position}")


def is_moving(client: Client) -> bool:
    return StateFlag.TURNTABLE_MOVING in status_of(client).state


def why_it_stopped(event: TurntableStopped) -> str:
    """One line on a turntable that did not arrive."""
    cause = {
        StopCause.STOPPED: "it was told to",
        StopCause.END_LOW: "the lower end switch was reached",
        StopCause.END_HIGH: "the upper end switch was reached",
        StopCause.FAULT: "a fault took its power away",
    }[event.cause]
    lost = ", above its start speed, so it may stand elsewhere: home and configure it" if event.lost else ""
    return f"the turntable stopped at step {event.position} because {cause}{lost}"


def turn(port: str, position: int, step_us: float, *, hold: bool) -> dict[str, object]:
    """Move the turntable and wait until it stands; a Ctrl-C brakes it. AnnulusError when it does not arrive."""
    with Client(port) as client:
        try:
            move_turntable(client, port, position, step_us, hold=hold)
        except KeyboardInterrupt:
            client.ask(TurntableStop())
            while is_moving(client):
                client.poll(KEEP_ALIVE_S)
        return {"turntable_steps": status_of(client).turntable}


def configure_turntable(
    port: str, *, lowest: int, highest: int, acceleration: int, start_us: float, switches: TurntableFlag
) -> dict[str, object]:
    """Soft limits, ramp and end switches; in force until the next reset. AnnulusError when refused."""
    with Client(port) as client:
        command = Turntable(lowest, highest, acceleration, round(start_us * TICKS_PER_US), switches)
        reply = client.request(command)
        assert isinstance(reply, TurntableReply)
        return {
            "lowest_steps": reply.lowest,
            "highest_steps": reply.highest,
            "acceleration_steps_s2": reply.acceleration,
            "start_us": reply.start_period / TICKS_PER_US,
            "switches": ", ".join(f.name.lower() for f in TurntableFlag if f in reply.switches and f.name) or "-",
        }


def stop_turntable(port: str) -> dict[str, object]:
    """Brake along the ramp, and wait until it stands."""
    with Client(port, diagnostics=True) as client:
        reply = client.request(TurntableStop())
        assert isinstance(reply, TurntableStopReply)
        while is_moving(client):
            client.keep_alive()
            client.poll(KEEP_ALIVE_S)
        return {"told_at_steps": reply.position, "turntable_steps": status_of(client).turntable}


def ticks_between(tick: int, later: int) -> int:
    """Of two ticks less than 21 s apart, as they wrap; negative when `later` has gone by."""
    return (later - tick + U32 // 2) % U32 - U32 // 2


def _pattern(bits: str) -> Pattern:
    if not bits or set(bits) - {"0", "1"} or len(bits) > CHIPS_MAX:
        raise AnnulusError(f"code {bits!r}: expected one of {', '.join(CODES)}, or up to {CHIPS_MAX} times 0 and 1")
    return Pattern(len(bits), int(bits[::-1], 2).to_bytes(CHIPS_MAX // 8, "little"))  # chip 0 is bit 0 of byte 0


def _wait_for(
    kind: type[Awaited], client: Client, port: str, patience_s: float, still: Callable[[], bool] = lambda: False
) -> Awaited:
    end = time.monotonic() + patience_s
    over = False
    while not over:
        left_s = end - time.monotonic()
        over = left_s <= 0.0 and not still()  # what has ended by now has been told: looked at once more
        client.keep_alive()
        for happening in client.poll(min(KEEP_ALIVE_S, left_s) if left_s > 0.0 else READ_AGAIN_S):
            if isinstance(happening, EventReceived) and isinstance(happening.event, kind):
                return happening.event
            _raise_on_fault(port, happening)
    raise AnnulusError(f"{port}: nothing ended within {patience_s:.1f} s, expected {kind.__name__}")


def _raise_on_fault(port: str, happening: object) -> None:
    """A fault whose BURST_DONE follows is told by that one; here only what ends everything."""
    if (
        isinstance(happening, EventReceived)
        and isinstance(happening.event, Fault)
        and happening.event.fault in LATCHING
    ):
        raise AnnulusError(f"{port}: fault {happening.event.fault.name.lower()}, everything disarmed")
    if isinstance(happening, EventReceived) and isinstance(happening.event, TurntableStopped):
        raise AnnulusError(f"{port}: {why_it_stopped(happening.event)}")
    if isinstance(happening, Rebooted) and happening.previous is not None:
        raise AnnulusError(f"{port}: the controller restarted, everything disarmed")


def text_of(raw: bytes) -> str:
    return "".join(c for c in raw.rstrip(b"\0").decode("ascii", "replace") if c.isprintable())


def _flags(state: StateFlag) -> str:
    return ", ".join(flag.name.lower().replace("_", " ") for flag in StateFlag if flag in state and flag.name) or "-"
