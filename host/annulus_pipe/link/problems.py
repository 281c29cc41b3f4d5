"""What is wrong between this host and a controller, each in one line for the user."""

from annulus_pipe.controller import LAMP_DUTY_MAX_PERMILLE, TICKS_PER_US
from annulus_pipe.link.codec import crc16
from annulus_pipe.link.messages import (
    PROTOCOL_VERSION,
    SCHEMA_HASH,
    Command,
    ConfigurationReply,
    FaultCode,
    IdentifyReply,
    Stage,
    StateFlag,
    StatusCode,
    StatusReply,
    StopCause,
)
from annulus_pipe.link.session import Answer
from annulus_pipe.vocabulary import Lamp

LATCHING = (  # faults that disarm everything until `clear`
    FaultCode.INTERLOCK,
    FaultCode.HOST_TIMEOUT,
    FaultCode.WATCHDOG,
    FaultCode.LIMIT,
    FaultCode.INTERLOCK_DISAGREES,
)
TAKEN_OVER = "another host has identified itself at the controller"
STOPPED = "somebody else switched the lamps off"


def configuration_problem(found: ConfigurationReply, asked: Stage) -> str:
    """Empty when what is in force is what was asked for, field by field and by its CRC; else one line."""
    for name in Stage.FIELDS:
        if getattr(found, name) != getattr(asked, name):
            return (
                f"the configuration in force is not the one asked for: {name} is {getattr(found, name)}, expected"
                f" {getattr(asked, name)}"
            )
    crc = configuration_crc(asked)
    if found.crc != crc:
        return f"the configuration in force has CRC {found.crc:04x}, expected {crc:04x}"
    return ""


def configuration_crc(stage: Stage) -> int:
    """As the controller computes it."""
    return crc16(stage.pack(), Stage.SCHEMA_BYTE)


def too_old(command: type[Command]) -> str:
    return (
        f"the controller's firmware is older than this annulus and has no {command.__name__.lower()}."
        " `annulus firmware flash` brings the one that has."
    )


def schema_problem(reply: IdentifyReply) -> str:
    """Empty when host and controller speak the same; else one line that says what to do."""
    if (reply.protocol, reply.schema) == (PROTOCOL_VERSION, SCHEMA_HASH):
        return ""
    return (
        f"controller speaks protocol {reply.protocol}, schema {reply.schema:08x}, expected {PROTOCOL_VERSION},"
        f" {SCHEMA_HASH:08x}. Flash the firmware that came with this annulus; until then it cannot be armed."
    )


def refusal(answer: Answer) -> str:
    """Why the controller would not, in one line."""
    name = type(answer.command).__name__.lower()
    status, detail = answer.reply.status, answer.reply.detail
    match status:
        case StatusCode.OUT_OF_RANGE:
            names = answer.command.FIELDS
            where = names[detail] if detail < len(names) else f"field {detail}"
            value = getattr(answer.command, where, "?")
            return f"{name} refused: {where} = {value} is out of range (protocol/REFERENCE.md has the ranges)"
        case StatusCode.WINDOW if isinstance(answer.command, Stage):
            return _window_refusal(answer.command, detail)
        case StatusCode.DUTY if isinstance(answer.command, Stage):
            return _duty_refusal(answer.command, detail)
        case StatusCode.DUTY:
            lamp = {1: "projector", 2: "led", 3: "microwave"}.get(detail, str(detail))
            since = ", or it comes too soon after the last train" if name == "burst" else ""
            return f"{name} refused: duty of the {lamp} is over the controller's limit{since}"
        case StatusCode.SCHEMA:
            return f"{name} refused: the schema differs. Flash the firmware that came with this annulus."
        case StatusCode.UNSAFE if name == "move" and detail in (StopCause.END_LOW, StopCause.END_HIGH):
            end = "lower" if detail == StopCause.END_LOW else "upper"
            return f"{name} refused: the {end} end switch is reached, or its wire is broken"
        case StatusCode.UNSAFE:
            return f"{name} refused: interlock open or a fault latched"
    return f"{name} refused: {status.name.lower()}, detail {detail}"


def _duty_refusal(stage: Stage, lamp: int) -> str:
    led = lamp == Lamp.LED
    width = stage.led_width if led else stage.projector_width
    us = TICKS_PER_US
    shortest = stage.frame_period - stage.frame_period * stage.tolerance // 1000
    return (
        f"{'led' if led else 'projector'} flash of {width / us:g} us is too long, expected"
        f" {shortest * LAMP_DUTY_MAX_PERMILLE / 1000 / us:g} us at most: {LAMP_DUTY_MAX_PERMILLE / 10:g} % of"
        f" {shortest / us:g} us, the shortest interval between edges ({1e6 * us / stage.frame_period:g} fps,"
        f" tolerance {stage.tolerance / 10:g} %)"
    )


def _window_refusal(stage: Stage, lamp: int) -> str:
    led = lamp == Lamp.LED
    delay, width = (stage.led_delay, stage.led_width) if led else (stage.projector_delay, stage.projector_width)
    us = TICKS_PER_US
    return (
        f"{'led' if led else 'projector'} flash {delay / us:g}..{(delay + width) / us:g} us leaves the window"
        f" {(stage.frame_period - stage.exposure) / us:g}..{(stage.frame_period - stage.readout) / us:g} us in which"
        f" all rows expose ({1e6 * us / stage.frame_period:g} fps, exposure {stage.exposure / us / 1000:g} ms,"
        f" readout {stage.readout / us / 1000:g} ms)"
    )


def is_stopped(status: StatusReply) -> bool:
    """Dark, and neither a fault nor a reset, which would have left no configuration in force."""
    dark = StateFlag.LAMPS_ARMED not in status.state
    return dark and status.fault is FaultCode.NONE and status.generation != 0
