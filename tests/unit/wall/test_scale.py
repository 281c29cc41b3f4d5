"""Diameters of heads whose optics have drifted: with a section of known diameter, and without."""

from dataclasses import replace

import numpy as np
import pytest
from drawn_heads import RADIUS, head, radius_of, scan

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.geometry.drift import Drift
from annulus_pipe.wall.explained import TRANSLUCENT, DriftPrior, Effects, answer_at, drift_before
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.offsets import observations, ring_offsets
from annulus_pipe.wall.optics import Optics, Prior
from annulus_pipe.wall.reference import (
    ReferenceSection,
    sections_from,
    sections_of,
    sections_recorded,
    sections_to_dict,
)
from annulus_pipe.wall.scale import SURE, AbsoluteScale, anchor, find_scale, scale_findings, with_drift, with_marks
from annulus_pipe.wall.within import _part

HERE = ReferenceSection(90.0, 120.0, 2 * RADIUS, 0.02)


def drawn(rng: np.random.Generator) -> Drift:
    """As the prior has them, walls that light enters among them."""
    shift = rng.choice([mm for mm, _ in TRANSLUCENT], p=[chance for _, chance in TRANSLUCENT])
    prior = Prior()
    sigma = np.array([prior.focal, prior.slide, 56 * prior.tube, prior.anamorphic])
    return Drift.of(rng.multivariate_normal(*drift_before(DriftPrior(np.zeros(4), sigma), shift)))


def measured(scale: AbsoluteScale | None, profiles: list, calibration) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Mean radius, mm, and what all of them may be off (k = 1)."""
    assert scale is not None
    radius = radius_of(list(with_drift(profiles, calibration, scale)))
    return radius, scale.part * radius


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("heads", [5, 200])
def test_k2_holds_for_drawn_heads_with_a_reference_section_and_without(heads: int) -> None:
    off: dict[str, list[tuple[float, float]]] = {"with": [], "without": []}
    for number in range(heads):
        rng = np.random.default_rng([40, number])
        calibration, radius = head(), RADIUS * (1 + rng.normal(0, 0.004))
        edges_px = float(np.exp(rng.uniform(np.log(0.01), np.log(0.2))))
        profiles = scan(calibration, drawn(rng), radius, rng, edges_px=edges_px)
        section = replace(HERE, diameter_mm=2 * radius + rng.normal(0, HERE.diameter_k2_mm / 2))
        for name, sections in (("with", [section]), ("without", [])):
            got, sigma = measured(find_scale(profiles, calibration, sections), profiles, calibration)
            off[name].append((got - radius, sigma))
    for name, least in (("with", 0.93), ("without", 0.9)):
        error, sigma = np.array(off[name]).T
        assert (np.abs(error) < 3.5 * sigma).all(), name
        if heads > 100:
            assert least <= (np.abs(error) < 2 * sigma).mean(), name
    error, sigma = np.array(off["with"]).T
    assert np.median(np.abs(error)) < 1e-4 * RADIUS and np.percentile(np.abs(error), 90) < 3e-4 * RADIUS
    assert np.median(sigma) < 2e-4 * RADIUS  # 0.01 % with the section's own 0.0066 %; measured 0.0098 %
    assert 1e-3 * RADIUS < np.median(np.array(off["without"])[:, 1]) < 6e-3 * RADIUS


@pytest.mark.parametrize("drift", [Drift(focal=0.001), Drift(slide=-0.0015), Drift(focal=0.002, slide=0.001)])
def test_what_rings_show_is_named_to_the_part(drift: Drift) -> None:
    rng = np.random.default_rng(1)
    scale = find_scale(scan(head(), drift, RADIUS, rng), head())
    assert scale is not None
    value, sigma = scale.of("focal", "slide")
    assert value == pytest.approx(drift.focal + drift.slide, abs=3 * sigma) and sigma < 3e-4
    assert any("focal length times the slide's scale" in finding.text for finding in scale_findings(scale))


@pytest.mark.parametrize("drift", [Drift(), Drift(tube_mm=0.08), Drift(focal=0.001, slide=-0.001)])
def test_what_rings_cannot_show_is_not_named_and_the_calibration_stays(drift: Drift) -> None:
    profiles = scan(head(), drift, RADIUS, np.random.default_rng(2))
    scale = find_scale(profiles, head())
    assert not scale_findings(scale) and with_drift(profiles, head(), scale) == tuple(profiles)
    radius, sigma = measured(scale, profiles, head())
    assert abs(radius - RADIUS) < 2 * sigma


def test_more_lens_and_less_slide_draw_a_wider_pipe_and_a_longer_tube_a_narrower() -> None:
    for drift, shift in ((Drift(focal=0.001, slide=-0.001), 0.001), (Drift(tube_mm=0.1), -0.1 / 56)):
        profiles = scan(head(), drift, RADIUS, np.random.default_rng(3))
        assert radius_of(profiles) / RADIUS - 1 == pytest.approx(shift, abs=3e-5)


def test_two_sections_measure_the_drift_within_a_scan() -> None:
    begin, end = Drift(focal=0.001), Drift(focal=0.0012, tube_mm=0.03)
    profiles = scan(head(), begin, RADIUS, np.random.default_rng(4), frames=60, step_mm=5.5, end=end)
    far = replace(HERE, from_mm=390.0, to_mm=430.0)
    for sections, worst in (([HERE, far], 3e-4), ([HERE], 6e-3)):
        out = with_drift(profiles, head(), find_scale(profiles, head(), sections))
        along = [abs(radius_of([one]) / RADIUS - 1) for one in out]
        assert max(along) < worst
    assert max(along) > 2e-4  # one section alone does not know of it


def test_a_section_that_no_drift_explains_anchors_nothing_and_is_reported() -> None:
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(5))
    scale = find_scale(profiles, head(), [replace(HERE, diameter_mm=160.0)])
    assert scale is not None and not scale.references and scale.part > 1e-3
    (finding,) = scale_findings(scale)
    assert "is no reference: it reads 152.4" in finding.text and "160.00 mm was stated" in finding.text


def test_a_section_that_nobody_saw_anchors_nothing() -> None:
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(6), frames=20)
    scale = find_scale(profiles, head(), [ReferenceSection(-300.0, -200.0, 152.4, 0.02)])
    assert scale is not None and not scale.references
    assert any("too little of its wall was seen" in one.text for one in scale_findings(scale))
    assert "no section that was named could be used" in anchor(scale, 152.4)


def test_an_anamorphic_drift_makes_no_oval_pipe() -> None:
    profiles = scan(head(), Drift(anamorphic=0.002), RADIUS, np.random.default_rng(7))
    scale = find_scale(profiles, head(), [HERE])
    assert scale is not None
    value, sigma = scale.of("anamorphic")
    assert value == pytest.approx(0.002, abs=3 * sigma) and sigma < 3e-4

    def oval(of: list) -> float:  # type: ignore[type-arg]
        points = np.concatenate([one.points_mm for one in of])
        turn, radius = np.arctan2(points[:, 1], points[:, 0]), np.hypot(points[:, 0], points[:, 1])
        return float(abs(2 * np.mean((radius - RADIUS) * np.exp(2j * turn))))

    before, after = oval(profiles), oval(list(with_drift(profiles, head(), scale)))
    assert after < 0.2 * before and after < 3 * scale.oval_part * RADIUS


def test_of_several_cameras_nothing_is_known() -> None:
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(8), frames=3)
    several = replace(head(), others=(HeadCamera(1, head().camera),))
    assert find_scale(profiles, several) is None and scale_findings(None) == ()


def test_sections_are_read_as_head_toml_has_them() -> None:
    data = {"sections_mm": [[900, 1020], [0, 120]], "diameter_mm": 152.4, "u_mm": 0.02}
    sections = sections_from(data)
    assert [one.from_mm for one in sections] == [0.0, 900.0]
    assert sections_recorded(sections_to_dict(sections)) == sections == sections_from(sections_to_dict(sections))
    assert sections_recorded({"sections_mm": "all"}) == () == sections_recorded({}) == sections_recorded(None)
    assert sections_of(["0:120", "900:1020"], 152.4, 0.02, "--reference") == sections


@pytest.mark.parametrize(
    ("word", "diameter_mm", "u_mm", "why"),
    [
        ("120:0", 152.4, 0.02, "expected FROM before TO by 5 mm or more"),
        ("0-120", 152.4, 0.02, "expected FROM:TO in mm, as 0:120"),
        ("0:nan", 152.4, 0.02, "expected FROM:TO in mm, as 0:120"),
        ("0:120", 1.0, 0.02, "diameter_mm"),
        ("0:120", 152.4, 20.0, "u_mm"),
        ("0:120", 152.4, 0.0, "u_mm"),
    ],
)
def test_a_section_that_is_none_is_refused_in_a_line(word: str, diameter_mm: float, u_mm: float, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        sections_of([word], diameter_mm, u_mm, "--reference")
    with pytest.raises(ValueError, match="overlaps"):
        sections_of(["0:120", "100:200"], 152.4, 0.02, "--reference")


def test_a_warm_head_of_known_make_is_allowed_for() -> None:
    optics = Optics.from_dict({"lens": "plastic", "tube": "acrylic", "calibrated_c": 20.0})
    prior = optics.prior([34.9, 35.0, 35.1])
    assert (prior.focal_mean, prior.tube_mean) == pytest.approx((1.5e-3, 1.05e-3)) and prior.focal < 1e-3
    assert optics.prior([]) == Optics().prior([35.0] * 9) == Prior()  # no reading, no temperature of the calibration
    drift = Drift(focal=0.0014, tube_mm=0.056, slide=0.0002)
    profiles = scan(head(), drift, RADIUS, np.random.default_rng(9))
    scale, blind = find_scale(profiles, head(), (), prior), find_scale(profiles, head())
    radius, sigma = measured(scale, profiles, head())
    assert blind is not None and abs(radius - RADIUS) < 2 * sigma and sigma < 0.7 * blind.part * RADIUS


@pytest.mark.parametrize(
    "data", [{"lens": "wood"}, {"colour": "red"}, {"calibrated_c": "warm"}, {"calibrated_c": 400.0}, {"lens": 3}, []]
)
def test_optics_that_are_none_are_refused_in_a_line(data: object) -> None:
    with pytest.raises(ValueError, match=r"\[optics\]"):
        Optics.from_dict(data)


def test_two_sections_that_contradict_each_other_anchor_nothing() -> None:
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(10), frames=20)
    other = ReferenceSection(150.0, 170.0, 2 * RADIUS + 1.0, 0.02)
    scale = find_scale(profiles, head(), [HERE, other])
    assert scale is not None and not scale.references and len(scale.refused) == 2
    assert any("contradict each other" in one.text for one in scale_findings(scale))


def test_one_ring_alone_says_nothing_of_the_scale() -> None:
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(11), frames=12)
    one = [profile.without(profile.ring != 2, "test") for profile in profiles]
    scale, all_rings = find_scale(one, head()), find_scale(profiles, head())
    assert scale is not None and all_rings is not None and scale.part > all_rings.part > 1e-3
    assert find_scale([], head()) is None and not scale_findings(scale)


def test_a_wall_that_was_measured_is_known_as_well_as_it_was() -> None:
    wall = replace(head(), translucency_mm=(0.25, 0.2, 0.15), translucency_sigma_mm=(0.01, 0.01, 0.01))
    light = Drift(red_mm=0.25, green_mm=0.2, blue_mm=0.15)
    profiles = scan(wall.in_wall(), Drift(), RADIUS, np.random.default_rng(12))
    assert radius_of(profiles) == pytest.approx(RADIUS, abs=0.05)
    radius, sigma = measured(find_scale(profiles, wall), profiles, wall)
    blind = scan(head(), light, RADIUS, np.random.default_rng(12))
    wider, unsure = measured(find_scale(blind, head()), blind, head())
    assert abs(radius - RADIUS) < 2 * sigma < 2 * unsure and abs(wider - RADIUS) < 2 * unsure


def test_a_window_keeps_what_all_radii_may_be_off() -> None:
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(13), frames=12)
    wall = replace(build_wall(profiles), scale_part=0.002, oval_part=0.001)
    part = _part(wall, 1, len(wall.z_mm) - 1)
    assert (part.scale_part, part.oval_part) == (0.002, 0.001) and len(part.z_mm) == len(wall.z_mm) - 2
    assert len(part.observations.cell) < len(wall.observations.cell)


def test_rings_of_few_points_leave_a_scale_unknown_and_not_exact() -> None:
    profiles = scan(head(), Drift(focal=0.001, tube_mm=0.1), RADIUS, np.random.default_rng(14), frames=20)
    few = [one.without(one.direction % 30 > 4, "test") for one in profiles]
    scale = find_scale(few, head())
    assert scale is None or scale.part > 1e-3


def step_in(section: ReferenceSection, profiles: list, mm: float) -> list:  # type: ignore[type-arg]
    """The pipe wider by so much from the middle of a section on."""
    middle, out = (section.from_mm + section.to_mm) / 2, []
    for one in profiles:
        points = one.points_mm.astype(np.float64)
        points[:, :2] *= (1.0 + np.where(points[:, 2] > middle, mm / RADIUS, 0.0))[:, None]
        out.append(replace(one, points_mm=points.astype(np.float32)))
    return out


def test_a_section_with_a_step_in_it_or_of_a_wrong_size_is_no_reference() -> None:
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(15))
    stepped = find_scale(step_in(HERE, profiles, 0.25), head(), [HERE])
    assert stepped is not None and not stepped.references and "a step, a taper" in stepped.refused[0][2]
    larger = find_scale(profiles, head(), [replace(HERE, diameter_mm=2 * RADIUS * 1.02)])
    assert larger is not None and not larger.references


def test_one_section_says_no_more_of_the_rest_of_a_scan_than_half_a_kelvin_allows() -> None:
    end = Drift(focal=5e-5, tube_mm=0.002)
    profiles = scan(head(), Drift(), RADIUS, np.random.default_rng(16), frames=60, step_mm=6.0, end=end)
    scale = find_scale(profiles, head(), [HERE])
    assert scale is not None
    last = radius_of(list(with_drift(profiles, head(), scale))[-3:])
    assert abs(last - RADIUS) < 2.5 * scale.part * RADIUS


def test_a_sensor_that_is_stuck_moves_nothing() -> None:
    assert Optics.from_dict({"calibrated_c": 20.0}).prior([85.0] * 9) == Prior()


def test_marks_over_a_known_length_of_cable_narrow_the_scale() -> None:
    for drift in (Drift(), Drift(tube_mm=0.1), Drift(focal=0.001, slide=-0.001)):
        profiles = scan(head(), drift, RADIUS, np.random.default_rng(17))
        scale = find_scale(profiles, head())
        assert scale is not None
        measured_mm = radius_of(list(with_drift(profiles, head(), scale)))
        f_r = drift.focal + (RADIUS - measured_mm) / RADIUS  # what marks and cable say, to 0.05 %
        narrower = with_marks(scale, (f_r, 0.0005))
        assert narrower is not None and narrower.part < 0.95 * scale.part
        assert abs(measured_mm - RADIUS) < 2.5 * narrower.part * RADIUS
        assert "marks on the wall" in anchor(narrower, 152.4)
        far = with_marks(scale, (0.05, 0.0005))
        assert far is not None and far.part == scale.part  # an odometer that is 5 % off says nothing of a scale
    assert with_marks(None, (0.0, 0.1)) is None and with_marks(scale, None) is scale


def bent_by(profiles: list, mm_per_mm2: float) -> list:  # type: ignore[type-arg]
    """The same wall, its middle on a parabola."""
    return [
        replace(one, points_mm=one.points_mm + np.float32([mm_per_mm2, 0.0, 0.0]) * (one.points_mm[:, 2:] - 150) ** 2)
        for one in profiles
    ]


def test_in_a_bend_nothing_is_named_a_drift() -> None:
    straight = scan(head(), Drift(focal=0.0015), RADIUS, np.random.default_rng(18))
    wound = []
    for bend in (0.0, 0.0006):
        seen = observations(bent_by(straight, bend))
        wound.append(ring_offsets(seen, len(head().rings), RADIUS))
    assert wound[0].bent_mm < 0.6 < 1.5 < wound[1].bent_mm  # measured 0.26 and 3.2 mm
    seen, sigma = observations(straight), Prior()
    before = DriftPrior(np.zeros(4), np.array([sigma.focal, sigma.slide, sigma.tube * 56, sigma.anamorphic]))
    effects = Effects.of(seen, wound[0].weight, head())

    def named(bent_mm: float) -> float:
        """How many standard deviations focal x slide is off by."""
        answer = answer_at(replace(wound[0], bent_mm=bent_mm), effects, before, wound[0].middle_mm)
        sum_of = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        return float(sum_of @ answer.mean / np.sqrt(sum_of @ answer.covariance @ sum_of))

    assert named(wound[0].bent_mm) > SURE > named(5.0)


def test_a_section_that_no_drift_explains_takes_no_other_with_it() -> None:
    profiles = scan(head(), Drift(focal=0.001), RADIUS, np.random.default_rng(19))
    wrong = ReferenceSection(150.0, 180.0, 2 * RADIUS + 8.0, 0.02)
    both, alone = find_scale(profiles, head(), [HERE, wrong]), find_scale(profiles, head(), [HERE])
    assert both is not None and alone is not None
    assert [one for one, _ in both.references] == [HERE] and [one for one, *_ in both.refused] == [wrong]
    assert both.part == pytest.approx(alone.part, rel=0.02)
