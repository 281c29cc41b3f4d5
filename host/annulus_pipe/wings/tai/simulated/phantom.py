"""What receivers all round hear of an instant of heat in a phantom: one run of the solver.

Sound is linear, so this response, convolved with whatever the microwave's envelope was, is every record.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.late import fft
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.field import PML_CELLS, Medium, Solver, SoundGrid, receivers
from annulus_pipe.wings.tai.measure.phantoms import Part, draw, reach_mm

SHIFT_MM = (0.0313, 0.0171)  # the phantom lies off the cells, so that no image is made on the grid of its own truth
FADE = 0.1  # of a response, at its end


@dataclass(frozen=True, slots=True, eq=False)
class RigSetup:
    """What the rig is made of. One pulse of 0.5 us on a part of value 1 makes `pulse_v` there and then."""

    phantom: tuple[Part, ...]
    radius_mm: float = 25.0
    sound_speed_m_s: float = 1480.0
    transducer: tuple[float, float] | None = (2.25e6, 0.7)  # centre, width at -6 dB
    pulse_v: float = 0.01
    noise_v: float = 0.0003  # rms of one shot
    spike_v: float = 0.0  # coupling of the microwave into the receiver
    steps_per_turn: int = 400
    stuck_after: int | None = None  # the turntable ignores every step after so many
    seed: int = 1

    def angle_deg(self, steps: int) -> float:
        return 360.0 * steps / self.steps_per_turn


class Responses:
    """What receivers all round hear of an instant of heat in the phantom: one run of the solver.

    Sound from within `reach` is limited in angle as it is in frequency; as many receivers as that takes make every
    angle between them exact.
    """

    def __init__(self, setup: RigSetup, progress: Callable[[str, int, int], None] | None = None) -> None:
        reach = reach_mm(setup.phantom)
        if reach > 0.95 * setup.radius_mm:
            raise AnnulusError(f"a phantom of {reach:.1f} mm does not fit receivers at {setup.radius_mm:g} mm")
        centre, width = setup.transducer or (1.5e6, 1.0)
        highest = self.highest_hz = centre * (1 + width)
        dx = max(setup.sound_speed_m_s * 1e3 / (2.4 * highest), setup.radius_mm / 400)
        side = fft.next_fast_len(math.ceil(2 * setup.radius_mm / dx) + 2 * PML_CELLS + 12, real=True)
        grid = SoundGrid((side, side), dx)
        solver = Solver(grid, Medium(setup.sound_speed_m_s))
        across_s = 2e-3 * setup.radius_mm / setup.sound_speed_m_s
        steps = math.ceil(1.15 * across_s / solver.dt_s)
        count = 2 * math.ceil(2 * math.pi * highest / (setup.sound_speed_m_s * 1e3) * reach) + 24
        turn = np.arange(count) * (2 * math.pi / count)
        points = setup.radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1) - np.array(SHIFT_MM)
        heard = solver.forward(
            draw(setup.phantom, grid, SHIFT_MM),
            receivers(grid, points),
            steps,
            progress=(lambda done, of: progress("twin's sound", done, of)) if progress else None,
        )
        if progress:
            progress("twin's sound", 1, 1)
        self.dt_s, self.length_s = solver.dt_s, steps * solver.dt_s
        fade = math.ceil(FADE * steps)  # a wave in a plane has a wake without end: it fades out rather than stops
        heard[:, -fade:] *= 0.5 + 0.5 * np.cos(math.pi * np.arange(1, fade + 1) / fade)
        self._round = fft.rfft(np.asarray(heard, float), axis=0)
        self._count = count

    def at(self, angle_deg: float) -> NDArray[np.float64]:
        """(steps,) pressure at an angle, from the instant of heat on, dt_s apart."""
        order = np.arange(len(self._round))
        weight = np.where((order == 0) | (2 * order == self._count), 1.0, 2.0) / self._count
        return np.asarray((weight * np.exp(1j * order * math.radians(angle_deg)) @ self._round).real)
