"""How long and how much lamps and microwave are on, at the pins alone; over any span, whatever came between."""

import itertools
from dataclasses import dataclass

from annulus_pipe.controller import (
    LAMP_DUTY_MAX_PERMILLE,
    LAMP_WIDTH_MAX_TICKS,
    MICROWAVE_DUTY_MAX_PERMILLE,
    MICROWAVE_PULSE_MAX_TICKS,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_PROJECTOR,
)
from annulus_pipe.link.messages import Burst, StatusCode
from tools.attack.boards import insist
from tools.attack.kept import Kept
from tools.attack.play import Player
from tools.attack.trains import chips_of

DUTY_SLACK = 200  # ticks: a board counts from the tick it reads, not from the pin


@dataclass(slots=True)
class Duty:
    """On-time owed, in ticks: filled by light, drained at the limit's rate."""

    permille: int
    owed: float = 0.0
    at: int = 0

    def rise(self, tick: int) -> float:
        self.owed = max(0.0, self.owed - (tick - self.at) * self.permille / 1000)
        self.at = max(self.at, tick)
        return self.owed

    def fall(self, rise: int, tick: int) -> None:
        """The drain of the on-time itself counts: whoever is on for w owes w less what drained."""
        self.owed = max(0.0, self.owed + (tick - rise) - (tick - rise) * self.permille / 1000)
        self.at = tick


class Limits:
    """Of one player; they go on across its scenes."""

    def __init__(self, player: Player) -> None:
        self.player = player
        self.duty = {
            PIN_PROJECTOR: Duty(LAMP_DUTY_MAX_PERMILLE),
            PIN_LED: Duty(LAMP_DUTY_MAX_PERMILLE),
            PIN_MICROWAVE: Duty(MICROWAVE_DUTY_MAX_PERMILLE),
        }
        self.burst_on = 0  # on-time of the longest burst yet
        self.flash_on = 0  # and of the longest flash

    def judge(self, kept: Kept) -> None:
        for asked in kept.asked:
            if isinstance(asked.command, Burst) and (asked.reply is None or asked.reply.status == StatusCode.OK):
                on = chips_of(kept, asked).count("1") * asked.command.chip
                legal = on * 1000 <= MICROWAVE_DUTY_MAX_PERMILLE * asked.command.period
                self.burst_on = max(self.burst_on, on if legal else 0)  # its answer may have gone with a pulled plug
        for pin, duty in self.duty.items():
            for rise, fall in kept.pulses.get(pin, ()):
                if pin != PIN_MICROWAVE:
                    self.flash_on = max(self.flash_on, fall - rise)
                slack = self.burst_on if pin == PIN_MICROWAVE else self.flash_on  # the share, and one on-time more
                owed = duty.rise(rise)
                share = 100 * (1 + owed / max(1, fall - rise)) * duty.permille / 1000
                insist(
                    owed <= slack + DUTY_SLACK,
                    f"GP{pin} over its duty: {owed:.0f} ticks owed, some {share:.0f} %",
                    rise,
                )
                duty.fall(rise, fall)
        for pin in (PIN_PROJECTOR, PIN_LED):
            for rise, fall in kept.pulses.get(pin, ()):
                insist(fall - rise <= LAMP_WIDTH_MAX_TICKS, f"GP{pin} on for {fall - rise} ticks", rise)
            insist(pin not in self.player.high, f"GP{pin} still on", self.player.high.get(pin, 0))
        both = sorted((r, f, p) for p in (PIN_PROJECTOR, PIN_LED) for r, f in kept.pulses.get(p, ()))
        for (_, fall, _), (rise, _, _) in itertools.pairwise(both):
            insist(rise >= fall, "both lamps on", rise)
        for rise, fall in kept.pulses.get(PIN_MICROWAVE, ()):
            insist(fall - rise <= MICROWAVE_PULSE_MAX_TICKS, f"microwave pulse of {fall - rise} ticks", rise)
