"""The second light's pure parts: slide, tube, lens, the kernel of a wall that scatters; and that it is a second one."""

import ast
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tools.bench.blind.draw import draw
from tools.light import kernel, lens, slide, tube
from tools.light.draw import effects_of, smaller
from tools.light.effects import Effects, Tube

LIGHT = Path(slide.__file__).parent
HEAD = draw(4003).head
RADIUS = 76.2


@pytest.fixture(autouse=True)
def _no_mitsuba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here may need the path tracer: it costs a second to load."""
    monkeypatch.setitem(__import__("sys").modules, "mitsuba", None)


def test_it_shares_no_light_with_the_other_drawer_the_twin_or_the_method() -> None:
    allowed = {f"tools.bench.blind.{name}" for name in ("head", "mesh", "pipe", "surface")}
    for path in LIGHT.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [one.name for one in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                ours = name.startswith(("annulus_pipe", "tools", "tests"))
                assert not ours or name.startswith("tools.light") or name in allowed, f"{path.name}: {name}"


def test_a_slide_is_half_dark_at_every_edge_of_a_slit_and_dark_in_its_middle() -> None:
    for inner, outer in HEAD.slits:
        at_edges = slide.transmission(HEAD, np.array([inner, outer]))
        beside = slide.transmission(HEAD, np.array([inner - 0.004, outer + 0.004]))
        assert at_edges == pytest.approx(beside / 2, abs=1e-6)
        assert slide.transmission(HEAD, np.array([(inner + outer) / 2])).max() == 0.0


def test_a_smear_moves_slits_downstream_by_its_mean_and_keeps_the_light() -> None:
    angles = slide.angles_of(HEAD)
    light = slide.transmission(HEAD, angles)
    still = slide.smeared(angles, light, RADIUS, lambda _: (np.zeros(1), np.ones((1, 3))))
    assert still == pytest.approx(light, abs=1e-3)
    moved = slide.smeared(angles, light, RADIUS, lambda _: (np.array([0.4, 0.6]), np.full((2, 3), 0.5)))
    inner, outer = HEAD.slits[3]
    near = (angles > inner - 0.004) & (angles < outer + 0.004)
    dark = [(one.max(axis=1) - one[near].max())[near] for one in (light, moved)]
    before, after = (float((one * RADIUS / np.tan(angles[near])).sum() / one.sum()) for one in dark)
    assert after - before == pytest.approx(0.5, abs=0.08)


def test_dust_is_the_same_for_the_same_seed_and_darkens_only() -> None:
    half = slide.OPEN * (HEAD.slits[-1][1] + HEAD.margin_rad)
    clean = slide.picture(slide.angles_of(HEAD), slide.transmission(HEAD, slide.angles_of(HEAD)), half)
    one, other = clean.copy(), clean.copy()
    slide.dusty(one, HEAD, half, 30, np.random.default_rng(3))
    slide.dusty(other, HEAD, half, 30, np.random.default_rng(3))
    assert np.array_equal(one, other)
    assert (one <= clean).all()
    assert 0.0 < (one < 0.5 * clean).sum() / (clean > 0.1).sum() < 0.05


def test_a_tube_about_the_axis_puts_a_ring_back_and_a_leaning_one_bends_it() -> None:
    glass = Tube(9.0, 2.0)
    theta, phi = np.array([[0.3], [0.6]]), np.linspace(-3.0, 3.0, 7)[None, :]
    hits = tube.on_wall(glass, theta, phi, RADIUS)
    for k, angle in enumerate(theta[:, 0]):
        assert hits[k, :, 2] == pytest.approx(RADIUS / math.tan(angle) - tube.behind_mm(glass, angle), abs=1e-9)
    leaning = tube.on_wall(replace(glass, lean_deg=(1.0, 0.0)), theta, np.array([[0.0, math.pi]]), RADIUS)
    less, more = (tube.behind_mm(glass, 0.6 - side * math.radians(1.0)) for side in (1.0, -1.0))
    aside = (less + more) * math.sin(math.radians(1.0)) / math.tan(0.6)  # it is put back along the tube
    assert leaning[1, 1, 2] - leaning[1, 0, 2] == pytest.approx(less - more - aside, rel=0.02)
    angles = slide.angles_of(HEAD)
    back = tube.behind_mm(glass, 0.5)
    came = tube.came(glass, back, angles, RADIUS)
    assert came(np.array([0.5]), np.array([1.0])) == pytest.approx(0.5, abs=1e-5)


def test_a_lens_of_lateral_colour_magnifies_red_and_leaves_green() -> None:
    y, x = np.mgrid[:200, :200]
    away = np.hypot(x - 99.5, y - 99.5)
    ring = np.exp(-((away - 80.0) ** 2) / 18.0)
    image = lens.lateral(np.stack([ring] * 3, -1), (0.01, -0.01), (99.5, 99.5))
    sizes = [float((image[..., c] * away).sum() / image[..., c].sum()) for c in range(3)]
    assert sizes[0] - sizes[1] == pytest.approx(0.8, abs=0.05)
    assert sizes[2] - sizes[1] == pytest.approx(-0.8, abs=0.05)
    assert np.array_equal(image[..., 1], ring)


def test_blur_of_a_curved_field_grows_outwards_and_veil_keeps_the_light() -> None:
    image = np.zeros((200, 200, 3))
    image[100, 100] = image[100, 180] = 1.0
    soft = lens.curved(image, 2.0, (99.5, 99.5))
    assert soft[100, 100, 0] > 0.9 > 0.2 > soft[100, 180, 0]
    veiled = lens.through_lens(image, Effects(veil=0.1), (99.5, 99.5))
    assert veiled.sum() == pytest.approx(image.sum(), rel=0.15)
    ghost = lens.through_lens(image, Effects(ghost=0.1), (99.5, 99.5))
    assert ghost[99, 19].sum() > 0.0 == image[99, 19].sum()


def test_a_fisheyes_picture_has_a_direction_where_its_focal_length_puts_it() -> None:
    plane = np.zeros((401, 401, 3))
    plane[196:205, 369:378] = 1.0  # 60 degrees, at a focal length of 100
    image = lens.fisheye(plane, 100.0, 60.0, (161, 161), (80.0, 80.0))
    row = image[80, :, 0]
    assert float((row * np.arange(161)).sum() / row.sum()) == pytest.approx(80.0 + 60.0 * math.pi / 3, abs=0.5)


def test_light_comes_out_of_a_wall_as_often_and_as_far_on_as_particles_that_wander_in_it() -> None:
    """The stored table is Mitsuba's; this walk shares nothing with it."""
    bins = np.linspace(-kernel.REACH, kernel.REACH, kernel.BINS)
    angle, albedo = math.radians(33.0), 0.9
    walked = _walk(albedo, *kernel.bent(angle), np.random.default_rng(5))
    shifts, table = kernel._table()
    row = table[kernel.ALBEDOS.index(albedo), kernel.HALF_ANGLES_DEG.index(33.0)]
    assert shifts == pytest.approx(bins)
    for part in (0.1, 0.5, 0.9):
        one, other = (float(np.interp(part, np.cumsum(w), bins)) for w in (row, walked))
        assert one == pytest.approx(other, abs=0.12)


def _walk(albedo: float, into: float, seen: float, rng: np.random.Generator, count: int = 30_000) -> np.ndarray:
    x, z = np.zeros(count), np.zeros(count)
    ahead, down = np.full(count, math.sin(into)), np.full(count, math.cos(into))
    edges = np.linspace(-kernel.REACH, kernel.REACH, kernel.BINS + 1)
    out, weight = np.zeros(kernel.BINS), 1.0
    for _ in range(60):
        way = rng.exponential(size=len(x))
        x, z = x + way * ahead, z + way * down
        inside = z > 0.0
        x, z = x[inside], z[inside]
        weight *= albedo
        leaves = weight * np.exp(-z / math.cos(seen))
        out += np.histogram(x - z * math.tan(seen), edges, weights=leaves)[0]
        down = rng.uniform(-1.0, 1.0, len(x))
        ahead = np.sqrt(1.0 - down**2) * np.cos(rng.uniform(0.0, 2.0 * math.pi, len(x)))
    return np.asarray(out / out.sum())


def test_a_kernel_is_of_one_light_grows_with_the_free_path_and_less_for_a_colour_that_is_absorbed() -> None:
    yellow = np.array([0.8, 0.6, 0.12])
    shifts, weights = kernel.parts(0.6, yellow, 0.2)
    assert weights.sum(axis=0) == pytest.approx(1.0)
    spread = np.sqrt(weights.T @ shifts**2)
    assert spread[0] > spread[1] > spread[2]
    twice = kernel.parts(0.6, yellow, 0.4)
    assert np.sqrt(twice[1].T @ twice[0] ** 2) == pytest.approx(2.0 * spread, rel=1e-6)
    assert (kernel.mean_shift(0.6, yellow, 0.2) > 0.0).all()


def test_a_pipe_has_the_same_effects_each_time_and_a_smaller_sensor_sees_the_same() -> None:
    scene = draw(4003)
    assert effects_of(scene) == effects_of(draw(4003)) != effects_of(draw(4004))
    small = smaller(scene)
    assert small.head.width <= 512
    scale = small.head.width / scene.head.width
    assert small.head.focal_px == pytest.approx(scale * scene.head.focal_px)
    middle = (small.head.centre_px[0] + 0.5) / small.head.width
    assert middle == pytest.approx((scene.head.centre_px[0] + 0.5) / scene.head.width)
