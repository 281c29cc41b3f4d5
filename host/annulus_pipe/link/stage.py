"""A lamp configuration as people think of it."""

from annulus_pipe.controller import TICKS_PER_US
from annulus_pipe.link.messages import Stage


def stage_from_us(
    *,
    ratio: int,
    period_us: float,
    exposure_us: float,
    readout_us: float,
    projector_us: tuple[float, float],
    led_us: tuple[float, float],
    tolerance_permille: int = 50,
    host_timeout_ms: int = 0,
) -> Stage:
    """A lamp configuration from microseconds; projector_us and led_us are (delay, width). HeadControl renumbers it.
    host_timeout_ms 0: the controller's own.
    """

    def ticks(us: float) -> int:
        return round(us * TICKS_PER_US)

    return Stage(
        generation=1,
        ratio=ratio,
        frame_period=ticks(period_us),
        exposure=ticks(exposure_us),
        readout=ticks(readout_us),
        tolerance=tolerance_permille,
        host_timeout=host_timeout_ms,
        projector_delay=ticks(projector_us[0]),
        projector_width=ticks(projector_us[1]),
        led_delay=ticks(led_us[0]),
        led_width=ticks(led_us[1]),
    )
