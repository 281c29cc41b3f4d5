"""What of a laminate's sound is left in air, in dB, before anybody builds the rig: source, way, receiver, codes.

One microwave pulse warms a laminate, and the water in it, so fast that nothing expands meanwhile: the pressure is
p0 = Gamma w, with w the heat a volume took (Eq. 7.3). Half of it travels to the near face, and of that 2 Za / (Za + Zs)
goes on in air: -76 dB in pressure, the well-known -35 dB in energy. A term is a gain in dB of pressure, or a level
re 1 Pa, with where it comes from; the sum against the receiver's own noise is what codes and averages have to make up.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annulus_pipe.controller import BURST_PERIOD_MIN_TICKS, CHIPS_MAX, CODES, MICROWAVE_DUTY_MAX_PERMILLE, TICK_S
from annulus_pipe.numeric.arrays import Chips, FloatArray
from annulus_pipe.numeric.late import fft
from annulus_pipe.vocabulary import AnnulusError

EPSILON0, ETA0_OHM = 8.8541878128e-12, 376.730313668  # F/m; CODATA 2018
BOLTZMANN = 1.380649e-23  # J/K; SI
ZERO_C_K = 273.15
AIR_DENSITY, AIR_SPEED = 1.204, 343.2  # kg/m^3, m/s at 20 C (ISO 9613-1: 343.2)
NEEDED_DB = 20.0  # a position's peak over rms noise, for a place to be found. Guard: topic single_sided
RECORD_S = 128e-6  # listening after a burst: the way through air, and until a laminate is still. Guard: the same topic
RIDGE = 0.005  # of a code's mean power in the band: dividing by less than that only amplifies noise


@dataclass(frozen=True, slots=True)
class Laminate:
    """A cross-ply of E-glass and epoxy, as one orthotropic material (x along the plate, z through it).

    Stiffness, GPa, and expansion, 1/K: Daniel and Ishai, Engineering Mechanics of Composite Materials (2006), table
    A.4, E-glass/epoxy, 0 and 90 deg in turn. `permittivity`, `tan_delta` at 2.45 GHz: Seo, Chin and Lee, Composite
    Structures 66 (2004) 533, low end of their losses. `attenuation_db_mm` at 300 kHz: linear in frequency from about
    0.7 dB/mm at 1 MHz, which differs twofold between laminates.
    """

    thickness_mm: float = 20.0
    c11_gpa: float = 28.0
    c13_gpa: float = 5.75
    c33_gpa: float = 13.5
    c55_gpa: float = 3.9
    density: float = 1900.0  # kg/m^3
    attenuation_db_mm: float = 0.2  # of pressure
    permittivity: float = 4.2
    tan_delta: float = 0.015
    expansion_x: float = 12e-6
    expansion_z: float = 35e-6
    heat_capacity: float = 1000.0  # J/(kg K)

    @property
    def speed(self) -> float:
        """Of longitudinal sound through the thickness, m/s."""
        return math.sqrt(1e9 * self.c33_gpa / self.density)

    @property
    def grueneisen(self) -> float:
        """Stress through the thickness for heat in a volume, where nothing may expand: C_3j alpha_j / (rho c_p)."""
        stress = 1e9 * (self.c33_gpa * self.expansion_z + 2 * self.c13_gpa * self.expansion_x)  # Pa/K
        return stress / (self.density * self.heat_capacity)

    @property
    def conductivity(self) -> float:
        """At 2.45 GHz, S/m."""
        return 2 * math.pi * MICROWAVE_HZ * EPSILON0 * self.permittivity * self.tan_delta


MICROWAVE_HZ = 2.45e9  # the source's (§7.4)
WATER_DENSITY, WATER_SPEED = 998.2, 1482.0  # kg/m^3, m/s at 20 C
WATER_GRUENEISEN = 2.07e-4 * WATER_SPEED**2 / 4182.0  # beta c^2 / c_p at 20 C: 0.109 (Eq. 7.3)
WATER_HEAT = WATER_DENSITY * 4182.0  # J/(m^3 K)


def water_conductivity() -> float:
    """Of water at 2.45 GHz and 20 C, S/m: one Debye term (Kaatze, J. Chem. Eng. Data 34 (1989) 371)."""
    static, fast, tau_s = 80.2, 5.6, 9.36e-12
    turn = 2 * math.pi * MICROWAVE_HZ * tau_s
    return 2 * math.pi * MICROWAVE_HZ * EPSILON0 * (static - fast) * turn / (1 + turn**2)


@dataclass(frozen=True, slots=True)
class SingleSidedRig:
    """A horn and receivers on one side of a plate, in air.

    `power_w` : peak; 5 kW is the source's generator (Epsco PG5KB, §8.5). `horn_mm` : aperture, whose field is strongest
    in the middle (twice the mean power, TE10). `face_mm` : of a receiver, along the plate and across. `receiver_db` :
    over the thermal noise of air at that face: half of a pair's insertion loss of 24 to 40 dB, and its amplifier
    (Alvarez-Arenas, IEEE Trans. UFFC 51 (2004) 624). `pulse_s` : one chip.
    """

    power_w: float = 5000.0
    horn_mm: tuple[float, float] = (120.0, 90.0)
    standoff_mm: float = 20.0
    face_mm: tuple[float, float] = (4.0, 20.0)
    receiver_db: float = 20.0
    band_hz: tuple[float, float] = (200e3, 400e3)
    pulse_s: float = 1.5e-6
    temperature_c: float = 20.0
    humidity_percent: float = 50.0

    def __post_init__(self) -> None:
        bounds = {
            "power, W": (self.power_w, 1.0, 1e7),
            "horn, mm": (min(self.horn_mm), 10.0, 1000.0),
            "stand-off, mm": (self.standoff_mm, 5.0, 500.0),
            "face of a receiver, mm": (min(self.face_mm), 0.5, 100.0),
            "receiver over thermal noise, dB": (self.receiver_db, 0.0, 120.0),
            "chip, us": (1e6 * self.pulse_s, 0.3, 30.0),
            "temperature, C": (self.temperature_c, -20.0, 50.0),
            "humidity, %": (self.humidity_percent, 10.0, 100.0),
        }
        for name, (value, low, high) in bounds.items():
            if not low <= value <= high:
                raise AnnulusError(f"{name} {value:g}, expected {low:g}..{high:g}")

    @property
    def middle_hz(self) -> float:
        return sum(self.band_hz) / 2

    def field(self, laminate: Laminate) -> float:
        """In the laminate under the horn's middle, V/m peak; what comes back from its far face is left out."""
        mean = self.power_w / (1e-6 * self.horn_mm[0] * self.horn_mm[1])
        return math.sqrt(2 * ETA0_OHM * 2 * mean) * 2 / (1 + math.sqrt(laminate.permittivity))

    def pressures_pa(self, laminate: Laminate) -> tuple[float, float]:
        """Initial pressure after one chip: in the laminate, and in water whose face the electric field runs along."""
        heat = self.pulse_s * self.field(laminate) ** 2 / 2  # J/m^3 for 1 S/m
        return (heat * laminate.conductivity * laminate.grueneisen, heat * water_conductivity() * WATER_GRUENEISEN)

    def noise_pa_rthz(self) -> float:
        """Noise equivalent pressure of a receiver, Pa/sqrt(Hz): 4 k T rho c / area, times its noise figure.

        The thermal noise of air at a face that is large to the wave (Mellen, JASA 24 (1952) 478).
        """
        area = 1e-6 * self.face_mm[0] * self.face_mm[1]
        heat = 4 * BOLTZMANN * (ZERO_C_K + self.temperature_c) * AIR_DENSITY * AIR_SPEED
        return math.sqrt(heat / area) * 10 ** (self.receiver_db / 20)

    def noise_pa(self) -> float:
        """Rms of one shot in the band."""
        return self.noise_pa_rthz() * math.sqrt(self.band_hz[1] - self.band_hz[0])


def air_absorption_db_m(frequency_hz: float, temperature_c: float = 20.0, humidity_percent: float = 50.0) -> float:
    """ISO 9613-1:1993, Eqs (3) to (5), B.2 and B.3, at 101.325 kPa. The standard tabulates to 10 kHz and gives the
    equations for ultrasound too, where the classical part (f^2) is most of it."""
    kelvin = ZERO_C_K + temperature_c
    ratio = kelvin / 293.15
    water = humidity_percent * 10 ** (-6.8346 * (273.16 / kelvin) ** 1.261 + 4.6151)  # molar part of vapour, %
    oxygen = 24 + 4.04e4 * water * (0.02 + water) / (0.391 + water)
    nitrogen = ratio**-0.5 * (9 + 280 * water * math.exp(-4.170 * (ratio ** (-1 / 3) - 1)))
    relaxing = 0.01275 * math.exp(-2239.1 / kelvin) / (oxygen + frequency_hz**2 / oxygen)
    relaxing += 0.1068 * math.exp(-3352.0 / kelvin) / (nitrogen + frequency_hz**2 / nitrogen)
    return float(8.686 * frequency_hz**2 * (1.84e-11 * ratio**0.5 + ratio**-2.5 * relaxing))


@dataclass(frozen=True, slots=True)
class Term:
    """One line of a budget: a level (dB re 1 Pa) or a gain (dB of pressure), and where it comes from."""

    name: str
    db: float
    source: str
    level: bool = False


@dataclass(frozen=True, slots=True)
class SoundBudget:
    """Of one kind of defect at one depth, one pulse, one shot. `missing_db` : to NEEDED_DB over the noise."""

    kind: str
    depth_mm: float
    terms: tuple[Term, ...]
    received_db: float  # re 1 Pa, at the receiver
    noise_db: float  # re 1 Pa, rms in the band
    missing_db: float


def budget(
    rig: SingleSidedRig, laminate: Laminate, kind: str, depth_mm: float, thick_mm: float = 1.0, wide_mm: float = 12.0
) -> SoundBudget:
    """From the warmed volume to the receiver, for water of that thickness, or a delamination.

    A delamination warms as little as the laminate, but has free faces: what is missing is the laminate's own pressure,
    which pushes its face by p0 / Z. Both are taken as discs, `wide_mm` across.
    """
    if kind not in ("water", "delamination"):
        raise AnnulusError(f"{kind!r}: expected water or delamination")
    if not (0 < depth_mm < laminate.thickness_mm and 0 < thick_mm < laminate.thickness_mm and 0 < wide_mm <= 1000):
        raise AnnulusError(
            f"depth {depth_mm:g}, thickness {thick_mm:g} mm: expected both above 0 and below {laminate.thickness_mm:g}"
        )
    own, water = rig.pressures_pa(laminate)
    middle = rig.middle_hz
    solid, air = laminate.density * laminate.speed, AIR_DENSITY * AIR_SPEED
    terms = [
        Term(
            "pressure after one chip",
            20 * math.log10(water if kind == "water" else own),
            "p0 = Gamma sigma E^2 tau / 2 (Eq. 7.3); "
            + ("water: Debye (Kaatze 1989)" if kind == "water" else "laminate: tan delta, C_3j alpha_j / (rho c_p)"),
            level=True,
        )
    ]
    if kind == "water":
        turn = 2 * math.pi * middle * emptying_s(laminate, thick_mm)
        terms.append(
            Term(
                f"{thick_mm:g} mm of it give way in {1e6 * turn / (2 * math.pi * middle):.2g} us",
                20 * math.log10(turn / math.hypot(1, turn)),
                "omega T / sqrt(1 + (omega T)^2), T = Z d / (2 K)",
            )
        )
    terms += [
        Term(
            "what the band keeps of a step",
            20 * math.log10(step_in_band(rig)),
            "1 / pi times the integral of sinc(f tau) / f over the band",
        ),
        Term("way through the laminate", -laminate.attenuation_db_mm * depth_mm, "0.7 dB/mm at 1 MHz, linear"),
        Term(
            "spread from a disc",
            20 * math.log10(spread(wide_mm, depth_mm, 1e3 * laminate.speed / middle)),
            "piston's axis, 2 sin(pi a^2 / (2 lambda d)), 1 at most",
        ),
        Term(
            f"solid to air ({10 * math.log10(4 * air * solid / (air + solid) ** 2):.1f} dB in energy)",
            20 * math.log10(2 * air / (air + solid)),
            "2 Za / (Za + Zs), normal incidence",
        ),
        Term(
            f"{rig.standoff_mm:g} mm of air",
            -1e-3 * rig.standoff_mm * air_absorption_db_m(middle, rig.temperature_c, rig.humidity_percent),
            f"ISO 9613-1 at {middle / 1e3:g} kHz",
        ),
    ]
    received = sum(term.db for term in terms)
    noise = 20 * math.log10(rig.noise_pa())
    return SoundBudget(kind, depth_mm, tuple(terms), received, noise, NEEDED_DB + noise - received)


def step_in_band(rig: SingleSidedRig) -> float:
    """Peak of a unit step that rose within a chip, behind the band."""
    f = np.linspace(*rig.band_hz, 401)
    return float(np.mean(np.sinc(f * rig.pulse_s) / f) * (rig.band_hz[1] - rig.band_hz[0]) / math.pi)


def emptying_s(laminate: Laminate, thick_mm: float) -> float:
    """In which a thin layer of water between two halves of laminate loses its pressure by pushing them apart, s."""
    stiff = WATER_DENSITY * WATER_SPEED**2
    return laminate.density * laminate.speed * 1e-3 * thick_mm / (2 * stiff)


def spread(wide_mm: float, depth_mm: float, wave_mm: float) -> float:
    """Pressure of a disc on its axis over that of an infinite plane, 1 at most (no gain is counted on in a near field).

    Fresnel's form of the piston's 2 sin(k (sqrt(d^2 + a^2) - d) / 2) (Kinsler et al., Fundamentals of Acoustics, 7.4).
    """
    return min(1.0, abs(2 * math.sin(math.pi * min((wide_mm / 2) ** 2 / (2 * wave_mm * depth_mm), 0.5))))


def warming_k_s(rig: SingleSidedRig, laminate: Laminate, duty: float) -> tuple[float, float]:
    """How fast laminate and water warm while nothing carries heat away, K/s: what bounds the time of a position."""
    heat = duty * rig.field(laminate) ** 2 / 2
    return (
        heat * laminate.conductivity / (laminate.density * laminate.heat_capacity),
        heat * water_conductivity() / WATER_HEAT,
    )


def golay(order: int) -> tuple[FloatArray, FloatArray]:
    """A complementary pair of 2^order signs: their autocorrelations' sidelobes cancel (Golay 1961)."""
    a, b = np.ones(1), np.ones(1)
    for _ in range(order):
        a, b = np.concatenate([a, b]), np.concatenate([a, -b])
    return a, b


TAPS = {7: (7, 6), 8: (8, 6, 5, 4)}  # x^7 + x^6 + 1 and x^8 + x^6 + x^5 + x^4 + 1: primitive (Golomb 1967)


def m_sequence(order: int) -> Chips:
    """The 2^order - 1 chips of a shift register; orders of TAPS."""
    state, chips = [1] * order, []
    for _ in range(2**order - 1):
        chips.append(state[-1])
        state = [sum(state[tap - 1] for tap in TAPS[order]) % 2, *state[:-1]]
    return np.array(chips, np.uint8)


SEQUENCES = ("single", "mpsl25-stuffed", "manchester", "golay64", "golay128", "m127", "m255")


def bursts_of(name: str) -> tuple[Chips, ...]:
    """The on/off bursts of a sequence. A Golay pair is sent as four: each sequence, and its complement."""
    if name in ("golay64", "golay128"):
        pair = golay(6 if name == "golay64" else 7)
        return tuple((sign * s > 0).astype(np.uint8) for s in pair for sign in (1.0, -1.0))
    if name in ("m127", "m255"):
        return (m_sequence(7 if name == "m127" else 8),)
    codes = ("manchester1", "manchester2") if name == "manchester" else (name,)
    if name not in SEQUENCES:
        raise AnnulusError(f"sequence {name!r}: expected one of {', '.join(SEQUENCES)}")
    return tuple(np.array([int(c) for c in CODES.get(code, "1")], np.uint8) for code in codes)


def spectra(bursts: Sequence[Chips], chip_s: float, frequency_hz: FloatArray) -> np.ndarray:
    """(bursts, frequencies): of unit impulses at the on-chips; a chip's own shape is the pulse's, and stays."""
    assert max(len(chips) for chips in bursts) <= CHIPS_MAX
    return np.stack(
        [np.exp(-2j * np.pi * chip_s * np.outer(frequency_hz, np.flatnonzero(chips))).sum(axis=1) for chips in bursts]
    )


@dataclass(frozen=True, slots=True)
class CodeCost:
    """What one sequence gains in the band, and how often the controller's limits let it be sent.

    `gain_db` : peak over noise of one shot, decoded in the band, against one single pulse. `sidelobe_db` : the highest
    beside the peak, of it. `period_s` : the shortest, by duty and record. `rate_db` : gain in equal time, over single
    pulses at their own shortest period.
    """

    name: str
    chips: int
    ones: float  # a burst, mean
    gain_db: float
    sidelobe_db: float
    period_s: float
    rate_db: float

    def seconds_for(self, missing_db: float) -> float:
        return self.period_s * max(1.0, 10 ** ((missing_db - self.gain_db) / 10))


def decoder(bursts: Sequence[Chips], chip_s: float, frequency_hz: FloatArray) -> np.ndarray:
    """(bursts, frequencies): what the shots' spectra are weighted with, and summed, to make one pulse's of them.

    conj(C) / (sum |C|^2 + ridge): the least-squares inverse in the band, of all bursts together. A burst and its
    complement differ in sign there but for a constant, which no band of sound has.
    """
    coded = spectra(bursts, chip_s, frequency_hz)
    power = (np.abs(coded) ** 2).sum(axis=0)
    return np.asarray(coded.conj() / (power + RIDGE * power.mean()))


def code_cost(name: str, rig: SingleSidedRig) -> CodeCost:
    bursts = bursts_of(name)
    f = np.linspace(*rig.band_hz, 801)
    taps = decoder(bursts, rig.pulse_s, f)
    through = (taps * spectra(bursts, rig.pulse_s, f)).sum(axis=0).real
    noise = math.sqrt(float((np.abs(taps) ** 2).sum(axis=0).mean()) * len(bursts))  # of as many shots as bursts, a shot
    gain = 20 * math.log10(float(through.mean()) / noise)
    window = through * np.hanning(len(f))
    output = np.abs(fft.ifft(window, 1 << 16))
    first = int(3 * (1 << 16) / len(f))  # behind Hann's own main lobe
    beside = float(output[first : len(output) // 2].max() / output[0])
    on_s = max(int(chips.sum()) for chips in bursts) * rig.pulse_s
    period = _period_s(on_s, max(map(len, bursts)) * rig.pulse_s)
    alone = _period_s(rig.pulse_s, rig.pulse_s)
    return CodeCost(
        name,
        max(map(len, bursts)),
        float(np.mean([chips.sum() for chips in bursts])),
        gain,
        20 * math.log10(max(beside, 1e-6)),
        period,
        gain - 10 * math.log10(period / alone),
    )


def _period_s(on_s: float, burst_s: float) -> float:
    """The shortest that duty, the record and the controller's least period allow."""
    return max(1000 * on_s / MICROWAVE_DUTY_MAX_PERMILLE, burst_s + RECORD_S, BURST_PERIOD_MIN_TICKS * TICK_S)
