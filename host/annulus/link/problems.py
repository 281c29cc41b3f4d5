"""What is wrong between this host and a controller, each in one line for the user."""

from annulus.link.codec import crc16
from annulus.link.messages import Command, ConfigurationReply, Stage


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
