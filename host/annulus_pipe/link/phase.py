"""How far a controller is on its way into service."""

from enum import StrEnum


class Phase(StrEnum):
    """How far the controller is. REFUSED and MISMATCH last until the configuration or the firmware changes, STOPPED
    until `arm`.
    """

    SEARCHING = "searching"
    LOOKING = "looking"  # are the lamps still as we left them?
    DISARMING = "disarming"
    GUARDING = "guarding"  # says which inputs the interlock has
    STAGING = "staging"
    WIRING = "wiring"  # says which pins are inverted
    TRIGGERING = "triggering"  # says how cameras are triggered
    SHARING = "sharing"  # says how many slides share the projector's flashes
    COMMITTING = "committing"
    VERIFYING = "verifying"  # reads back what is in force ..
    CONFIRMING = "confirming"  # .. and which pins are inverted with it ..
    SHARED = "shared"  # .. and how many slides are lit in turn
    PREPARING = "preparing"  # says how optical preambles are to be
    CLEARING = "clearing"
    ARMING = "arming"
    RUNNING = "running"  # armed, as asked
    IDLE = "idle"  # configured, or nothing to configure; dark, as asked
    STOPPED = "stopped"  # by somebody else; dark, and kept so
    REFUSED = "refused"
    MISMATCH = "mismatch"
