"""What a bench engineer does with one controller at a time: `annulus head`. Each verb opens the port, acts and leaves
the outputs as it says, also when interrupted.
"""

import time
from collections.abc import Callable
from typing import TypeVar

from annulus.link.client import Client
from annulus.link.head import LATCHING
from annulus.link.messages import (
    CHIPS_MAX,
    TICK_HZ,
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
    Edge,
    Fault,
    FaultCode,
    Move,
    Pattern,
    Stage,
    StageDone,
    StageReply,
    StateFlag,
    Status,
    StatusReply,
    SyncLost,
)
from annulus.link.session import EventReceived, EventsLost, Rebooted
from annulus.vocabulary import TICKS_PER_US, AnnulusError, Lamp

KEEP_ALIVE_S = 0.1  # well inside the shortest sensible host timeout
TRAIN_SLACK_S = 1.0
STAGE_BUSY_S = 60.0
U32 = 2**32

Awaited = TypeVar("Awaited", BurstDone, StageDone)


def status(port: str) -> dict[str, object]:
    """Identity, state and counters, with units in the names."""
    with Client(port, diagnostics=True) as client:
        who = client.identity
        reply = client.request(Status())
        assert isinstance(reply, StatusReply)
        return {
            "board": _text(who.board),
            "firmware": _text(who.git),
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
            "stage_steps": reply.stage,
            "bad_frames": reply.bad_frames,
            "late_flashes": reply.late,
            "event_overruns": reply.overruns,
        }


def configure(port: str, stage: Stage) -> dict[str, object]:
    """Stage, validate, commit. AnnulusError with the controller's reason when it refuses."""
    with Client(port) as client:
        reply = client.request(stage)
        assert isinstance(reply, StageReply)
        client.request(Commit(stage.generation))
        return {
            "generation": reply.generation,
            "window_opens_us": reply.window_open / TICKS_PER_US,
            "window_closes_us": reply.window_close / TICKS_PER_US,
        }


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


def fire_burst(
    port: str, code: str, *, chip_us: float, repeat: int, period_us: float, offset_us: float
) -> dict[str, object]:
    """Arm the microwave, fire, wait for the end of the train, disarm.

    code : a built-in one's name, or a text of 0 and 1, which is uploaded.

    Raises AnnulusError for a code nobody knows, a refusal (interlock, limits), or a fault that cut the train off.
    """
    own, burst = train_from_us(code, chip_us=chip_us, repeat=repeat, period_us=period_us, offset_us=offset_us)
    with Client(port) as client:
        if own is not None:
            client.request(own)
        reply, done = send_train(client, port, burst)
    return {
        "code": code,
        "chips": reply.length,
        "chip_us": burst.chip / TICKS_PER_US,
        "bursts": done.done,
        "period_us": burst.period / TICKS_PER_US,
        "train_us": (done.tick - reply.start) % U32 / TICKS_PER_US,
    }


def train_from_us(
    code: str, *, chip_us: float, repeat: int, period_us: float, offset_us: float
) -> tuple[Pattern | None, Burst]:
    """A train from microseconds, and the pattern to upload before it if the code is not built in."""
    names = {c.name.lower().replace("_", "-"): c for c in BurstCode if c is not BurstCode.UPLOADED}
    own = _pattern(code) if code and not set(code) - {"0", "1"} else None
    if code not in names and own is None:
        raise AnnulusError(f"--code {code!r}: expected one of {', '.join(names)}, or a text of 0 and 1")
    for option, us, low, high in (
        ("--chip-us", chip_us, 0.1, 30.0),
        ("--period-us", period_us, 1.0, 4e7),
        ("--trigger-offset-us", offset_us, -1e6, 1e6),
    ):
        if not low <= us <= high:
            raise AnnulusError(f"{option} {us:g}: expected {low:g}..{high:g}")
    return own, Burst(
        code=names.get(code, BurstCode.UPLOADED),
        chip=round(chip_us * TICKS_PER_US),
        repeat=repeat,
        period=round(period_us * TICKS_PER_US),
        trigger_offset=round(offset_us * TICKS_PER_US),
    )


def send_train(client: Client, port: str, burst: Burst) -> tuple[BurstReply, BurstDone]:
    """Arm the microwave, fire, wait for the end, disarm whatever happens.

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
    return reply, done


def status_of(client: Client) -> StatusReply:
    reply = client.request(Status())
    assert isinstance(reply, StatusReply)
    return reply


def move_stage(client: Client, port: str, position: int, step_us: float, *, hold: bool) -> None:
    """To an absolute position in steps, and wait until it stands. `hold` keeps the motor powered afterwards."""
    end = time.monotonic() + STAGE_BUSY_S
    while StateFlag.STAGE_MOVING in (before := status_of(client)).state:  # somebody's earlier move
        if time.monotonic() > end:
            raise AnnulusError(f"{port}: the stage still moves after {STAGE_BUSY_S:g} s, expected it to stand")
        client.poll(KEEP_ALIVE_S)
    if before.stage == position and hold:
        return
    client.request(Move(position, round(step_us * TICKS_PER_US), int(hold)))
    patience_s = abs(position - before.stage) * step_us * 1e-6 + TRAIN_SLACK_S
    done = _wait_for(StageDone, client, port, patience_s)
    if done.position != position:
        raise AnnulusError(f"{port}: the stage stopped at step {done.position}, expected {position}")


def _pattern(bits: str) -> Pattern:
    if len(bits) > CHIPS_MAX:
        raise AnnulusError(f"--code: {len(bits)} chips, expected {CHIPS_MAX} at most")
    return Pattern(len(bits), int(bits[::-1], 2).to_bytes(CHIPS_MAX // 8, "little"))  # chip 0 is bit 0 of byte 0


def _wait_for(kind: type[Awaited], client: Client, port: str, patience_s: float) -> Awaited:
    end = time.monotonic() + patience_s
    while (now := time.monotonic()) < end:
        client.keep_alive()
        for happening in client.poll(min(KEEP_ALIVE_S, end - now)):
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
    if isinstance(happening, Rebooted) and happening.previous is not None:
        raise AnnulusError(f"{port}: the controller restarted, everything disarmed")


def _text(raw: bytes) -> str:
    return "".join(c for c in raw.rstrip(b"\0").decode("ascii", "replace") if c.isprintable())


def _flags(state: StateFlag) -> str:
    return ", ".join(flag.name.lower().replace("_", " ") for flag in StateFlag if flag in state and flag.name) or "-"
