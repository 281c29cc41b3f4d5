"""Figure 7.3: a disc of glycol with air bubbles, by what table 7.1 says of five concentrations."""

import math
from typing import Any

import numpy as np

from annulus_pipe.wings.tai.measure.electromagnetics import FREQUENCY_HZ
from annulus_pipe.wings.tai.measure.field import Medium, Solver, receivers, time_step_s
from annulus_pipe.wings.tai.measure.phantoms import Disc, draw
from tools.study.figure import Figure
from tools.study.images import Frame
from tools.study.microwaves import OIL_SPEED, absorbed_w, in_front_of_guide, loss_on, under_gaussian

TABLE_7_1 = (  # bubbles %, conductivity S/m, relative permittivity, speed of sound m/s; eps at 2.45 GHz
    (0, 2.32, 14.03, 1660.7),
    (20, 1.33, 9.66, 1729.8),
    (30, 1.11, 8.34, 1805.6),
    (35, 0.95, 7.38, 1922.6),
    (40, 0.84, 6.86, 2049.4),
)
RADIUS_MM = 6.0  # §7.6.2
PULSE_S = 0.5e-6  # at half maximum, as that of the source's reference
RECEIVER_MM = 12.0  # above the disc's middle


def concentrations(pixel_mm: float = 0.2, em_step_mm: float = 1.0) -> Figure:
    """The signal above a disc of 12 mm in oil for each row of table 7.1: sigma, eps and c change together.

    The source states neither beta, C_p nor density of a row. `swing` has the same beta / C_p in all rows (Eq. 7.10):
    pressure goes with c^2 sigma |E|^2. `swing_same_gruneisen` has the same beta c^2 / C_p: pressure goes with the loss.
    Density is the oil's.
    """
    frame = Frame(14.0, 14.0, pixel_mm)
    grid = frame.grid
    fastest = Medium(max(row[3] for row in TABLE_7_1))
    dt = time_step_s(grid, fastest)
    steps = math.ceil(30e-3 / OIL_SPEED / dt)
    ear = receivers(grid, np.array([[0.0, -RECEIVER_MM]]))
    cover = draw((Disc(0.0, 0.0, RADIUS_MM, 1.0),), grid)
    signals, numbers = [], {}
    for percent, sigma, eps_r, speed in TABLE_7_1:
        part = (Disc(0.0, 0.0, RADIUS_MM, sigma),)
        field = in_front_of_guide(part, eps_r, em_step_mm)
        rise = speed**2 * loss_on(field, part, grid, pixel_mm, (0.0, 0.0))
        solver = Solver(grid, Medium(OIL_SPEED + (speed - OIL_SPEED) * cover), dt)
        signals.append(under_gaussian(solver.forward(rise, ear, steps).astype(float), dt, PULSE_S)[0])
        numbers[f"absorbed_{percent}_w"] = absorbed_w(field)
    first = float(np.ptp(signals[0]))
    for (percent, *_, speed), signal in zip(TABLE_7_1, signals, strict=True):
        numbers[f"swing_{percent}"] = swing = float(np.ptp(signal)) / first
        numbers[f"swing_same_gruneisen_{percent}"] = swing * (TABLE_7_1[0][3] / speed) ** 2
        numbers[f"apart_{percent}_us"] = 1e6 * dt * abs(int(np.argmax(signal)) - int(np.argmin(signal)))
        numbers[f"across_{percent}_us"] = 2e3 * RADIUS_MM / speed

    def paint(figure: Any) -> None:
        left, right = figure.subplots(1, 2)
        times_us = 1e6 * dt * np.arange(steps)
        for (percent, *_), signal in zip(TABLE_7_1, signals, strict=True):
            left.plot(times_us, signal / first, lw=0.9, label=f"{percent} % bubbles")
        left.set(xlabel="time after the pulse, us", ylabel="pressure, of the swing without bubbles", xlim=(2, 18))
        left.set_title(f"12 mm disc in oil, receiver {RECEIVER_MM:g} mm above", fontsize=9)
        left.legend(fontsize=7)
        percents = [row[0] for row in TABLE_7_1]
        right.plot(percents, [numbers[f"swing_{p}"] for p in percents], "o-", label="swing, same beta / C_p")
        same = [numbers[f"swing_same_gruneisen_{p}"] for p in percents]
        right.plot(percents, same, "o--", label="swing, same Grueneisen parameter")
        absorbed = [numbers[f"absorbed_{p}_w"] / numbers["absorbed_0_w"] for p in percents]
        right.plot(percents, absorbed, "s--", label="power absorbed")
        right.plot(percents, [row[1] / TABLE_7_1[0][1] for row in TABLE_7_1], "^:", label="conductivity")
        right.set(xlabel="bubbles, % of the volume", ylabel="of that without bubbles", ylim=(0, None))
        right.set_title(f"what table 7.1 does at {FREQUENCY_HZ / 1e9:g} GHz", fontsize=9)
        right.legend(fontsize=7)

    return Figure(numbers, paint, (11, 4))
