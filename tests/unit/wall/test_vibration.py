"""What shakes with the head goes, what is the wall's own stays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import SHADOW_RATIO, round_pipe, scan

from annulus_pipe.wall.defects import find_defects
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.vibration import without_vibration

STATIONS = [2.4 * i for i in range(64) if i % 5 != 4]


def shaken(profiles, period_mm=31.0, amplitude_mm=0.3):
    out = []
    for profile in profiles:
        points = profile.points_mm.astype(float)
        radius = np.hypot(points[:, 0], points[:, 1])
        points[:, :2] *= (1 + amplitude_mm * np.sin(2 * math.pi * profile.z_mm / period_mm) / radius)[:, None]
        out.append(replace(profile, points_mm=points.astype(np.float32)))
    return out


def corrugated(clock, z):
    return round_pipe(clock, z) + 0.3 * np.sin(2 * np.pi * z / 31.0)


def rms(profiles, pipe):
    wall = build_wall(profiles)
    off = (wall.radius_mm - pipe(wall.clock_deg[None], wall.z_mm[:, None]))[20:-20]
    return float(np.sqrt(np.nanmean(off**2)))


@pytest.mark.parametrize("pipe", [round_pipe, corrugated], ids=["smooth wall", "wall as wavy as the shaking"])
def test_shaking_is_found_named_and_taken_out(pipe):
    seen = shaken(scan(pipe, z_mm=STATIONS, directions=180))
    calm, found = without_vibration(seen, fps=25.0)
    (line,) = found.lines
    assert line.cycles_per_m == pytest.approx(1000 / 31.0, rel=0.03)  # the section holds five periods
    pace = (seen[-1].z_mm - seen[0].z_mm) / (seen[-1].frame - seen[0].frame)  # mm a frame
    assert line.hertz == pytest.approx(25 * pace / 31.0, rel=0.03)
    assert line.amplitude_mm == pytest.approx(0.3, rel=0.05) and line.mm[0][0] == "radius"
    still = rms(scan(pipe, z_mm=STATIONS, directions=180), pipe)
    assert rms(seen, pipe) > 3 * still and rms(calm, pipe) < 1.3 * still


def test_a_wall_that_is_really_wavy_stays():
    profiles = scan(corrugated, z_mm=STATIONS, directions=180)
    calm, found = without_vibration(profiles)
    assert found.lines == ()
    assert all((a.points_mm == b.points_mm).all() for a, b in zip(calm, profiles, strict=True))


def test_a_groove_keeps_its_depth():
    def groove(clock, z):
        return round_pipe(clock, z) + 2.0 * ((z > 150) & (z < 170))

    def depth(profiles):
        return max(d.depth_mm for d in find_defects(build_wall(profiles), shadow_ratio=SHADOW_RATIO).defects)

    profiles = scan(groove, z_mm=STATIONS, directions=180)
    alone = depth(profiles)
    assert depth(without_vibration(profiles)[0]) == pytest.approx(alone)
    assert depth(without_vibration(shaken(profiles))[0]) == pytest.approx(alone, rel=0.006)


def test_too_short_a_section_comes_back_whole_and_says_why():
    profiles = scan(round_pipe, z_mm=STATIONS[:8], directions=180)
    calm, found = without_vibration(profiles)
    assert found.lines == () and "8 frames" in found.why and calm == tuple(profiles)
