"""Losses against closed forms, and a waveguide that does not depend on its grid."""

import math

import numpy as np
import pytest

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.confinement import confinement
from annulus_pipe.wings.tai.measure.electromagnetics import (
    OIL,
    Dielectric,
    attenuation,
    disc,
    half_space_loss,
    nodes,
    open_waveguide,
    plane_wave,
    slab_loss,
)


@pytest.mark.parametrize("eps_r", [1.0, 3.0])
@pytest.mark.parametrize("thickness", [30.0, math.inf])
def test_the_loss_peaks_where_theory_says(eps_r, thickness):
    sigmas = np.geomspace(0.3, 3.0, 41)
    media = [Dielectric(eps_r, float(sigma)) for sigma in sigmas]
    theory = [half_space_loss(m, 10) if math.isinf(thickness) else slab_loss(m, thickness, 10) for m in media]
    found = [plane_wave(m, thickness, 10, 0.5) for m in media]
    assert max(found) == pytest.approx(max(theory), rel=0.0015)
    assert abs(int(np.argmax(found)) - int(np.argmax(theory))) <= 1
    assert 0.6 < sigmas[np.argmax(theory)] < 1.1  # "near 1 S/m" (§7.8.2)


def test_a_thick_slab_is_a_half_space():
    medium = Dielectric(9.0, 3.0)
    assert slab_loss(medium, 400.0, 10.0) == pytest.approx(half_space_loss(medium, 10.0), rel=1e-7)


def test_attenuation_is_that_of_the_complex_wave_number():
    medium = Dielectric(14.03, 2.32)
    k = 2 * math.pi * 2.45e9 / 299792458.0 * np.sqrt(medium.permittivity(2.45e9))
    assert attenuation(medium) == pytest.approx(-k.imag, rel=1e-9)


def waveguide(step):
    x, y, h = nodes(60.0, 60.0, step)
    cover = disc(x, y, (0.0, 25.0), 10.0)
    eps = OIL.permittivity(2.45e9) * (1 - cover) + Dielectric(20.0, 1.0).permittivity(2.45e9) * cover
    field = open_waveguide(eps, h, x, y, power_w=1000.0)
    absorbed = field.loss_w_m3.sum() * (1e-3 * h) ** 2 * 43.18e-3
    return field, absorbed, cover


def test_the_waveguide_converges_and_keeps_its_energy():
    (coarse, first, _), (fine, second, cover) = waveguide(2.0), waveguide(1.0)
    assert second == pytest.approx(first, rel=0.02)
    assert abs(fine.reflection) == pytest.approx(abs(coarse.reflection), abs=0.02)
    assert second < 1000.0 * (1 - abs(fine.reflection) ** 2)  # no more than went in
    assert (fine.loss_w_m3[cover == 0] == 0).all()
    assert np.allclose(fine.e_v_m, fine.e_v_m[:, ::-1], rtol=1e-9, atol=1e-10)  # as symmetric as what it looks at


def test_bad_input_is_one_line():
    x, y, h = nodes(60.0, 40.0, 4.0)
    with pytest.raises(AnnulusError, match="carries no wave"):
        open_waveguide(np.ones((len(y), len(x)), complex), h, x, y, 1.0, frequency_hz=1e9)
    with pytest.raises(AnnulusError, match="unknowns"):
        nodes(500.0, 500.0, 0.05)
    with pytest.raises(AnnulusError, match="pulse_s"):
        confinement(1.0, -1.0)


def test_a_long_pulse_is_warned_of():
    short, long = confinement(1.0, 0.5e-6), confinement(0.6, 2e-6)
    assert short.warnings == ()
    assert short.thermal_s == pytest.approx(1e-6 / (4 * 1.43e-7))
    assert len(long.warnings) == 1
    assert "3 mm" in long.warnings[0]
