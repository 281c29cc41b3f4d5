"""What a controller finds about itself on its board: what carries it, VBUS, the interlock's inputs."""

from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import BoardKind, Hardware, HardwareReply, Interlock, InterlockFlag, InterlockReply
from annulus_pipe.link.problems import too_old
from annulus_pipe.vocabulary import AnnulusError


def hardware_fields(client: Client) -> dict[str, object]:
    """What the controller finds about itself."""
    found = client.request(Hardware()) if client.session.knows(Hardware) else None
    if not isinstance(found, HardwareReply):
        return dict.fromkeys(("carrier", "vbus", "interlock"))
    return {
        "carrier": carrier_line(found),
        "vbus": found.vbus.name.lower(),
        "interlock": interlock_line(found.interlock),
    }


def use_both_inputs(port: str) -> InterlockFlag:
    """The interlock has a second input from now on; what both say. AnnulusError for a controller that cannot look."""
    with Client(port) as client:
        if not client.session.knows(Interlock):
            raise AnnulusError(f"{port}: {too_old(Interlock)}")
        reply = client.request(Interlock(InterlockFlag.ANTIVALENT))
        assert isinstance(reply, InterlockReply)
        return reply.inputs


def carrier_line(found: HardwareReply) -> str:
    """The board under the chip, and what goes with it."""
    match found.board:
        case BoardKind.PICO:
            return "Pico"
        case BoardKind.PICO_W:
            return "Pico W (no status light, VBUS not sensed)"
    return "unknown (VBUS not sensed)"


def interlock_line(inputs: InterlockFlag) -> str:
    """What its inputs say, in one line."""
    first = "open" if InterlockFlag.OPEN in inputs else "closed"
    if InterlockFlag.ANTIVALENT not in inputs:
        return f"{first} (GP7)"
    second = "open" if InterlockFlag.ANTIVALENT_OPEN in inputs else "closed"
    return f"{first} (GP7 and GP13)" if first == second else f"contradicts itself: GP7 {first}, GP13 {second}"
