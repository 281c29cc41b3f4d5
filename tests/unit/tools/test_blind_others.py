"""Promises of the blind draws of other methods: what is drawn is what is called true, and tables count rightly."""

import math
from collections import Counter

import numpy as np
import pytest

from tools.bench.blind.others import KINDS, bore_logs, calibration, fringe, joint_volumes, stereo
from tools.bench.blind.others.joints import near
from tools.bench.blind.others.tally import Case, markdown
from tools.bench.blind.run import main
from tools.bench.blind.score import Number


def test_every_kind_is_offered_and_has_a_module() -> None:
    assert set(KINDS) == {"joints", "crossbore", "calibration", "stereo", "fringe"}
    with pytest.raises(SystemExit):
        main(["--of", "nothing", "--seed", "2"])


@pytest.mark.parametrize("seed", range(6))
def test_a_joint_is_as_thick_at_its_notch_as_its_surfaces_are_apart(seed: int) -> None:
    joint = joint_volumes.draw(np.random.default_rng(seed))
    phi = np.linspace(0, 6, 50)
    far = np.full_like(phi, 1e3)
    wall = joint.surface(False, phi, far) - joint.surface(True, phi, far)
    notch = joint.surface(False, phi, 0 * phi) - joint.surface(True, phi, 0 * phi)
    assert wall == pytest.approx(joint.wall * (1 + joint_volumes.wave(joint.wall_wave, phi)), abs=1e-9)
    assert notch == pytest.approx(wall + sum(joint.floors) * (1 + joint_volumes.wave(joint.bead_wave, phi)), abs=1e-9)


def test_hardening_lowers_a_wall_and_most_what_is_deep_in_it() -> None:
    ray, curve = joint_volumes.hardening(np.array([[24.0], [30.0]]), 30.0)
    inside = (ray > 24.5) & (ray < 29.5)
    assert (curve[inside] > 0).all()
    assert curve[inside][0] > curve[inside][-1]


def test_a_flaw_is_met_where_it_is_only() -> None:
    void = joint_volumes.Flaw("void", 1.0, 27.0, 0.5, 0.4, -1.0)
    reported = {"kind": "void", "phi_deg": math.degrees(1.0), "rho": 27.0, "from_joint_mm": 0.6, "arc_deg": 2.0}
    assert near(void, reported, 0.3)
    assert not near(void, reported | {"from_joint_mm": 3.0}, 0.3)


def test_a_sewer_is_what_of_it_the_pipe_meets() -> None:
    z, theta = np.arange(0.0, 2000.0, 5.0), np.radians(np.arange(0.0, 360.0, 6.0))
    for level, kind in ((-200.0, "air"), (200.0, "water"), (0.0, "part")):
        sewer = bore_logs.Sewer(1000.0, 100.0, 0.0, 90.0, 90.0, level, 10.0, 6.5)
        bore_logs.settle(sewer, z, theta)
        assert sewer.kind == kind
        assert sewer.span_mm == pytest.approx((905.0, 1095.0), abs=6.0)


def test_a_walk_is_as_alike_as_it_says() -> None:
    walk = bore_logs.walk(np.random.default_rng(1), 200_000, 20.0)
    assert np.std(walk) == pytest.approx(1.0, abs=0.05)
    assert np.mean(walk[20:] * walk[:-20]) == pytest.approx(math.exp(-1), abs=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_a_lens_sends_rays_back_to_their_pixels(seed: int) -> None:
    lens = calibration.draw(np.random.default_rng(seed))
    pixels = np.array([[30.0, 40.0], [lens.width - 20.0, 90.0], [lens.centre[0] + 3.0, lens.centre[1]]])
    rays = lens.rays(pixels)
    away = lens.distance(np.arccos(rays[:, 2]))
    off = (pixels - lens.centre) * [1, 1 + lens.shear]
    assert away == pytest.approx(np.hypot(*off.T), abs=0.02)


def test_a_word_names_each_of_its_edges_once() -> None:
    for seed in range(20):
        word = stereo.draw_word(np.random.default_rng(seed), 8)
        assert len({word[k : k + 2] for k in range(7)}) == 7


def test_a_slab_is_as_high_as_it_says_and_a_groove_as_deep() -> None:
    x, y = np.array([3.0, 30.0]), np.array([2.0, 2.0])
    things = [fringe.Thing("slab", 3.0, 2.0, 5.0, 5.0, 0.3, 1.2), fringe.Thing("groove", 3.0, 2.0, 5.0, 0.5, 0.3, 0.4)]
    assert fringe.relief(things, x, y) == pytest.approx([0.8, 0.0])


def test_a_table_counts_what_is_right_wrong_and_not_said() -> None:
    case = Case(2000, "a case", [("void", "missed", "nothing")], ["grain at 3"], unsaid=Counter({"width": 2}))
    case.numbers = [Number("width", "all round", 1.0, 0.1, 1.05), Number("width", "all round", 1.0, 0.1, 1.5)]
    case.odds = [("air", 0.9, True), ("air", 0.8, False)]
    text = markdown([case], {2001: "ValueError: why"}, "# head")
    for line in (
        "| width | all round | 50 (1..99) of 2 | |",
        "| width | | | 2 |",
        "| air | 2 | 85.0 % | 50.0 % (1.3 to 98.7) |",
        "- 2000: void: missed: nothing",
        "- 2000: false: grain at 3",
        "| 2001 | broke: ValueError: why | | | |",
    ):
        assert line in text
