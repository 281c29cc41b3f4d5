"""The views of both halves: what C paints is what painting far places first, near ones over them, would give."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.report import halves
from annulus_pipe.report.halves import BACKGROUND, half_view


def wall(rows: int, step_deg: float = 5.0, z_step_mm: float = 4.0) -> Any:
    return SimpleNamespace(
        mean_radius_mm=40.0, z_mm=7.0 + np.arange(rows) * z_step_mm, z_step_mm=z_step_mm, clock_step_deg=step_deg
    )


NAMES = [one.name for one in halves._half_view.arguments]


def painted(*arguments: Any) -> None:
    """The door's arguments, painted place by place: those farther off first, of two as far the earlier."""
    one = SimpleNamespace(**dict(zip(NAMES, arguments, strict=True)))
    upper = np.clip(np.floor(one.row).astype(int), 0, len(one.map) - 1)
    lower, down = np.minimum(upper + 1, len(one.map) - 1), (one.row - np.floor(one.row))[:, None]
    total, weight = np.zeros((2, len(one.row), len(one.part)))
    for rows, a in ((upper, 1 - down), (lower, down)):
        for columns, b in ((one.left, 1 - one.part), (one.beside, one.part)):
            value = one.map[rows][:, columns]
            total += np.where(np.isfinite(value), value, 0.0) * a * b
            weight += a * b * np.isfinite(value)
    deviation = (total / np.maximum(weight, 1e-9)).astype(np.float32)
    r = np.float32(one.radius) + np.float32(one.exaggeration) * deviation
    slope_t = np.clip(np.gradient(r, one.turn, axis=1) / r, -3, 3)
    slope_z = np.clip(np.gradient(r, one.advance, axis=0), -3, 3)
    inward = np.stack([slope_t * one.cosine - one.sine, one.cosine + slope_t * one.sine, slope_z], axis=-1)
    shade = 0.5 + 0.49 * np.clip(inward @ one.lamp / np.linalg.norm(inward, axis=-1), 0, 1)
    points = np.stack(np.broadcast_arrays(r * one.sine, -r * one.cosine, one.along[:, None]), axis=-1) - one.origin
    x, y, far = np.moveaxis(points @ one.axes.T, -1, 0)
    height, width = one.canvas.shape[:2]
    u = np.rint(x * one.scale + (width - 1) / 2).astype(int)
    v = np.rint(y * one.scale + (height - 1) / 2).astype(int)
    drawn = (weight >= 0.5) & one.facing & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    paint = (one.colour[np.rint(one.row).astype(int)][:, one.nearest] * shade[..., None]).astype(np.uint8)
    order = np.argsort(-far[drawn], kind="stable")
    one.canvas[v[drawn][order], u[drawn][order]] = paint[drawn][order]


@settings(max_examples=12)
@given(
    rows=st.integers(2, 30),
    seed=st.integers(0, 99),
    holes=st.floats(0.0, 1.0),
    clock=st.sampled_from([0.0, 90.0, 200.0, 359.0]),
    dent=st.floats(0.0, 15.0),
)
def test_a_half_is_as_it_would_be_painted(rows: int, seed: int, holes: float, clock: float, dent: float) -> None:
    draw, monkeypatch = np.random.default_rng(seed), pytest.MonkeyPatch()
    map_mm = draw.normal(0.0, dent, (rows, 72)).astype(np.float32)
    map_mm[draw.random(map_mm.shape) < holes] = np.nan
    colour = draw.integers(0, 256, (rows, 72, 3), dtype=np.uint8)
    ours = half_view(wall(rows), map_mm, colour, slice(0, rows), clock, width=80, height=120)
    with monkeypatch.context() as changed:
        changed.setattr(halves, "_half_view", painted)
        theirs = half_view(wall(rows), map_mm, colour, slice(0, rows), clock, width=80, height=120)
    off = np.abs(ours.image.astype(int) - theirs.image.astype(int)).max(axis=-1)
    assert (off > 1).mean() < 2e-3, "but for places on the edge between two pixels"


def test_what_was_not_seen_is_a_hole() -> None:
    map_mm = np.full((20, 72), np.nan, np.float32)
    view = half_view(wall(20), map_mm, np.zeros((20, 72, 3), np.uint8), slice(0, 20), 90.0, width=80, height=120)
    assert (view.image == BACKGROUND).all()
