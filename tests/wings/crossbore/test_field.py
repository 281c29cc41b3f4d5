"""The field of a capacitive head: against closed forms, against itself, against a prototype's field."""

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.measure.elements import (
    EPS0_PF_PER_MM,
    ElectrodeField,
    graded,
    grid_of,
    permittivity,
    solve,
)
from annulus_pipe.wings.crossbore.measure.field import (
    AIR,
    SOIL,
    WATER,
    Along,
    CrossSection,
    HeadGeometry,
    StraightBore,
    along,
    sectors,
)

WALL, WET = 2.25, permittivity(20.0, 0.01)
INNER, MIDDLE, OUTER = 10.0, 14.0, 20.0


def cylinder(kind: str, fine: int = 1) -> ElectrodeField:
    """Two conductors 10 and 20 mm in radius, PE up to 14 mm and wet soil from there."""
    rho, phi = np.linspace(INNER, OUTER, 20 * fine + 1), np.linspace(0, 2 * np.pi, 72 * fine + 1)
    grid = grid_of([rho, phi if kind == "rp" else np.linspace(0.0, 5.0, 4)], kind)
    own = grid.axes[:, 0]
    return solve(
        grid,
        lambda middle, points: np.where(middle[:, :1] < MIDDLE, WALL, WET) + 0 * points[0],
        [own < INNER + 1e-6],
        own > OUTER - 1e-6,
    )


@pytest.mark.parametrize(("kind", "length"), [("rp", 1.0), ("rz", 5.0)])
def test_a_coaxial_capacitor_of_two_layers_has_its_closed_form(kind: str, length: float) -> None:
    layers = math.log(MIDDLE / INNER) / WALL + math.log(OUTER / MIDDLE) / WET
    expected = 2 * math.pi * EPS0_PF_PER_MM / layers
    found = complex(cylinder(kind).pf[0, 0]) / length
    assert abs(found - expected) < 2e-3 * abs(expected)
    assert found.imag < 0  # a conducting layer loses: eps' - j eps''


def test_loss_of_soil_is_its_conductivity_over_omega_eps0() -> None:
    assert permittivity(20, 0.01) == pytest.approx(20 - 27.66j, abs=0.01)  # at 6.5 MHz wet soil conducts more
    assert permittivity(20, 0.01, 65e6).imag == pytest.approx(-2.766, abs=0.001)


def three_plates() -> ElectrodeField:
    """Each sector alone at 1 V in a quarter-turned soil with a bore beside it: nothing symmetric."""
    case = CrossSection(soil=WET, bore=StraightBore(AIR, 60.0, 55.0, 80.0))
    driven = sectors(case).field
    grid, own = driven.grid, driven.grid.axes
    angle = np.degrees(own[:, 1])
    plates = [
        (np.abs(own[:, 0] - 30.5) < 1e-6) & (np.abs((angle - middle + 180) % 360 - 180) < 55.001)
        for middle in (0, 120, 240)
    ]
    return solve(grid, lambda middle, points: driven.eps, plates, own[:, 0] > 159.99)


def test_what_one_plate_sees_of_another_the_other_sees_of_it() -> None:
    field = three_plates()
    assert np.abs(field.pf - field.pf.T).max() < 1e-10 * np.abs(field.pf).max()
    assert len(set(np.round(np.diag(field.pf), 4))) == 3


def test_energy_is_half_c_v_squared_and_sensitivities_add_up() -> None:
    field = three_plates()
    volts = np.array([1.0, -0.5, 0.25])
    energy = field.share(volts, volts).sum() / 2
    assert energy == pytest.approx(volts @ field.pf @ volts / 2, rel=1e-9)
    # eps dC/deps of all elements is C, between one plate and another too
    assert field.share([1, 0, 0], [0, 1, 0]).sum() == pytest.approx(field.pf[0, 1], rel=1e-9)


def test_sensitivity_of_the_wall_is_the_change_with_its_permittivity() -> None:
    plain = CrossSection(shield=False)
    found = sectors(plain).field
    rho = found.grid.middle[:, 0]
    wall = (rho > plain.pipe.inner_mm) & (rho < plain.pipe.outer_mm)
    # the only plate at 1 V is the driven one: C = its charge
    slope = found.share([1, 0, 0], [1, 0, 0])[wall].sum().real * plain.head.electrode_mm
    step = 0.01
    more, less = (
        sectors(replace(plain, pipe=replace(plain.pipe, eps=2.25 * (1 + way * step)))).pf[0] for way in (1, -1)
    )
    assert slope == pytest.approx((more - less) / (2 * step), rel=1e-3)


def test_halving_the_mesh_moves_no_reading_by_a_hundredth() -> None:
    for soil, shield in ((AIR, True), (SOIL, True), (SOIL, False)):
        across = [sectors(CrossSection(soil=soil, shield=shield, fine=fine)).pf for fine in (1, 2)]
        assert np.abs(across[1] / across[0] - 1).max() < 0.01
        pairs = [along(Along(soil, soil, shield=shield, fine=fine)) for fine in (1, 2)]
        assert pairs[1].differential_pf == pytest.approx(pairs[0].differential_pf, rel=0.01)
        assert pairs[1].mutual_pf == pytest.approx(pairs[0].mutual_pf, rel=0.01)


def test_the_differential_signal_rises_from_air_to_soil_and_the_mutual_falls() -> None:
    """Figure 10.5 shows a rise. Sensed single-ended, soil takes the charge to earth."""
    air, soil, water = (along(Along(one, one)) for one in (AIR, SOIL, WATER))
    assert 0.2 < soil.differential_pf - air.differential_pf < 0.35
    assert water.differential_pf > soil.differential_pf
    assert air.mutual_pf > 1.5 * soil.mutual_pf > 1.5 * water.mutual_pf > 0
    assert soil.single_pf > air.single_pf


def test_an_active_shield_leaves_the_swing_and_takes_the_standing_capacitance() -> None:
    on, off = (
        [along(Along(one, one, shield=shield)).differential_pf for one in (AIR, SOIL)] for shield in (True, False)
    )
    assert on[1] - on[0] == pytest.approx(off[1] - off[0], rel=0.1)
    assert off[0] > 12 * on[0]


def test_half_of_the_signal_comes_from_the_first_millimetres_of_soil() -> None:
    """A prototype's field: half within 4.5 mm of the wall. So thick a layer of air takes half of the swing."""
    air, soil, layer = (
        along(one).differential_pf for one in (Along(AIR, AIR), Along(), Along(AIR, SOIL, depth_mm=4.5))
    )
    assert 0.45 < (soil - layer) / (soil - air) < 0.55


def test_a_bore_of_three_inches_is_seen_and_a_boundary_passes_without_a_jump() -> None:
    swing = along(Along()).differential_pf - along(Along(AIR, AIR)).differential_pf
    bore = along(Along()).differential_pf - along(Along(AIR, SOIL, -38.0, 38.0)).differential_pf
    assert 0.65 * swing < bore < 0.85 * swing  # the pair is 72 mm long, and its far ends look into the soil
    passing = [along(Along(SOIL, AIR, from_mm=z)).differential_pf for z in np.arange(-60.0, 61.0, 20.0)]
    assert (np.diff(passing) < 2e-3 * swing).all()


def test_a_head_off_its_axis_reads_more_where_it_is_nearer() -> None:
    air, soil, off = (
        sectors(one).pf for one in (CrossSection(soil=AIR), CrossSection(), CrossSection(off_mm=(1.0, 0.0)))
    )
    assert off[0] > soil[0] > off[1] == pytest.approx(off[2], rel=1e-3)
    assert 0.1 < (off[0] - soil[0]) / (soil[0] - air[0]) < 0.5


def test_across_the_pipe_a_half_bore_is_of_the_sectors_that_face_it() -> None:
    whole = sectors(CrossSection()).pf - sectors(CrossSection(bore=StraightBore())).pf
    half = sectors(CrossSection()).pf - sectors(CrossSection(bore=StraightBore(offset_mm=76.0))).pf
    assert half[1] > 0.8 * whole[1]
    assert 0.2 * whole[0] < half[0] < 0.6 * whole[0]
    assert half[2] < 0.1 * whole[2]


def test_a_roll_turns_the_sectors_with_the_head() -> None:
    bore = StraightBore(offset_mm=76.0)
    turned = sectors(CrossSection(bore=bore, roll_deg=120.0)).pf
    assert turned[0] == pytest.approx(sectors(CrossSection(bore=bore)).pf[1], rel=2e-3)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: sectors(CrossSection(off_mm=(6.0, 0.0))), "6 mm off the axis"),
        (lambda: HeadGeometry(sector_deg=120.0), "sectors of 120 deg"),
        (lambda: HeadGeometry(overlap_mm=6.0), "shields that do not touch"),
        (lambda: along(Along(from_mm=3.0, to_mm=3.0)), "expected lengths above 0"),
        (lambda: sectors(CrossSection(fine=0.0)), "expected above 0"),
    ],
)
def test_a_shape_that_is_none_is_told(make: object, told: str) -> None:
    with pytest.raises(AnnulusError, match=told):
        make()  # type: ignore[operator]


def test_a_missing_extra_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(AnnulusError, match='the extra "crossbore"'):
        sectors(CrossSection())


def test_nodes_lie_on_every_mark() -> None:
    nodes = graded([0.0, 5.0, 6.0, 40.0], [1.0, 1.0, 4.0], 0.3)
    assert {0.0, 5.0, 6.0, 40.0} <= set(nodes.tolist())
    assert (np.diff(nodes) > 0).all()
    assert np.diff(nodes).max() <= 4.0
