"""The speed of sound by agreement, and the receiver that agrees with no other, against known truth.

Sound in space is that of small heated spheres, in closed form; sound in a plane is the solver's.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.decode import decode_record, sweep_of
from annulus_pipe.wings.tai.measure.agreement import AGREEMENT, Arrival, disagreeing, search_sound_speed
from annulus_pipe.wings.tai.measure.phantoms import phantom
from annulus_pipe.wings.tai.measure.sweep import Sweep
from annulus_pipe.wings.tai.simulate import Setup, simulate, through
from tests.wings.tai.test_agreement import ANGLES, RADIUS, RATE, C, spheres
from tools.bench.table import Row

BANDS = {"every frequency": None, "2.25 MHz, 70 %": (2.25e6, 0.7), "1 MHz, 70 %": (1e6, 0.7), "0.5 MHz": (0.5e6, 1.0)}
WITHIN = 0.002
NOISE = 0.3  # of the sound's rms
DAMAGED = (0, 17, 33)


def in_space() -> Iterable[tuple[str, Sweep]]:
    for count, seed in ((3, 1), (12, 3)):
        rng = np.random.default_rng(seed)
        far, turn = 10.0 * np.sqrt(rng.random(count)), rng.uniform(0, 2 * np.pi, count)
        parts = np.stack(
            [
                far * np.cos(turn),
                far * np.sin(turn),
                rng.normal(0, 0.3, count),
                rng.uniform(0.3, 1.5, count),
                rng.uniform(0.3, 1.0, count),
            ],
            axis=1,
        )
        for name, band in BANDS.items():
            signals = through(spheres(parts), Setup(sampling_rate_hz=RATE, transducer=band))
            yield f"{count} spheres in space, {name}", noisy(Sweep(signals, ANGLES, RADIUS, RATE, 0.0, C))


def in_a_plane() -> Iterable[tuple[str, Sweep]]:
    for sample in ("inclusions", "core", "wires"):
        for name, band in BANDS.items():
            setup = Setup(chip_s=0.3e-6, sampling_rate_hz=10e6, transducer=band, sound_speed_m_s=C)
            sweep = sweep_of(decode_record(simulate(phantom(sample), setup))[0])
            yield f"{sample} in a plane, {name}", noisy(sweep)


def noisy(sweep: Sweep) -> Sweep:
    noise = np.random.default_rng(0).standard_normal(sweep.signals.shape)
    return replace(sweep, signals=sweep.signals + NOISE * sweep.signals.std() * noise)


def rows() -> list[Row]:
    table: list[Row] = []
    accused = named = wrongly = told_apart = planes = 0
    kinds: list[tuple[Arrival, Iterable[tuple[str, Sweep]]]] = [("space", in_space()), ("plane", in_a_plane())]
    for arrival, sweeps in kinds:
        for what, sweep in sweeps:
            found, other = search_sound_speed(sweep, 0.945 * C, 1.055 * C, arrival)
            off = found.sound_speed_m_s / C - 1
            right = found.agreement > other.agreement
            planes, told_apart = planes + (arrival == "plane"), told_apart + (right and arrival == "plane")
            table.append(
                Row(
                    f"speed of sound, {what}",
                    "-",
                    f"within {100 * WITHIN:g} %" + (", told by agreement" if arrival == "space" else ""),
                    f"{100 * off:+.3f} %, agreement {found.agreement:.3f}; taken for the other "
                    f"{100 * (other.sound_speed_m_s / C - 1):+.2f} %, {other.agreement:.3f}",
                    abs(off) <= WITHIN and (right or arrival == "plane"),
                )
            )
            accused += len(disagreeing(sweep, arrival))
            for position in DAMAGED:
                signals = sweep.signals.copy()
                signals[position] = -signals[position]
                bad = {one[0] for one in disagreeing(replace(sweep, signals=signals), arrival)}
                named, wrongly = named + (position in bad), wrongly + len(bad - {position})
    tried = len(table) * len(DAMAGED)
    return [
        *table,
        noise_alone(),
        Row("sound in a plane told from sound in space by agreement alone", "-", "-", f"{told_apart} of {planes}"),
        Row(
            "sound receivers accused, in all of these",
            "-",
            "0",
            f"{accused} of {len(table) * len(ANGLES)}",
            not accused,
        ),
        Row("one receiver turned round: named", "-", "-", f"{named} of {tried}; {wrongly} others with it"),
    ]


def noise_alone() -> Row:
    """The highest agreement that a search over noise finds."""
    most = 0.0
    for seed in range(4):
        noise = np.random.default_rng(seed).standard_normal((len(ANGLES), 950))
        try:
            best, _ = search_sound_speed(Sweep(noise, ANGLES, RADIUS, RATE, 0.0, C), 0.945 * C, 1.055 * C)
            most = max(most, best.agreement)
        except AnnulusError as error:
            most = max(most, float(str(error).split("correlation ")[1].split(")")[0]))
    return Row("agreement of noise alone, 4 searches", "-", f"< {AGREEMENT}", f"{most:.2f}", most < AGREEMENT)
