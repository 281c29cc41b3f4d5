"""Is a pulse short enough? Heat and stress must stay where they were left, or p0 = beta c^2 J / C_p does not hold."""

from dataclasses import dataclass

from annulus_pipe.vocabulary import AnnulusError

WATER_DIFFUSIVITY_M2_S = 1.43e-7


@dataclass(frozen=True, slots=True)
class Confinement:
    """Both times in s, and one line for each that the pulse does not keep (Alzuhiri 2022, §7.3)."""

    thermal_s: float
    stress_s: float
    warnings: tuple[str, ...]


def confinement(
    size_mm: float, pulse_s: float, sound_speed_m_s: float = 1500.0, diffusivity_m2_s: float = WATER_DIFFUSIVITY_M2_S
) -> Confinement:
    """For structures of `size_mm`: tau_th = L^2 / 4 D (the square, which the source leaves out), tau_s = L / c."""
    for name, value in (("size_mm", size_mm), ("pulse_s", pulse_s), ("sound_speed_m_s", sound_speed_m_s)):
        if not 0 < value < float("inf"):
            raise AnnulusError(f"{name} is {value:g}, expected a positive number")
    length = size_mm * 1e-3
    thermal, stress = length**2 / (4 * diffusivity_m2_s), length / sound_speed_m_s
    warnings = []
    if pulse_s > thermal:
        warnings.append(
            f"heat leaves {size_mm:g} mm in {1e3 * thermal:.3g} ms, before the pulse of {1e6 * pulse_s:.3g} us is over"
        )
    if pulse_s > stress:
        warnings.append(
            f"sound leaves {size_mm:g} mm in {1e6 * stress:.3g} us, before {1e6 * pulse_s:.3g} us of pulse are over: "
            f"details below {1e3 * pulse_s * sound_speed_m_s:.2g} mm blur and their amplitude reads low"
        )
    return Confinement(thermal, stress, tuple(warnings))
