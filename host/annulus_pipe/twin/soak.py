"""Labels under faults in virtual time: the firmware, the link, navigation and labelling as the daemon has them, scored
by lamp and by place against what really lit each frame. `annulus twin soak` prints what `soak` returns.

A long run is several worlds, each with a seed and its share of faults, on as many processes as there are cores; what
they found is added. The result does not depend on how many processes there were. `truth` says what wrong means,
`pictures` what of the camera is kept instead of drawn.
"""

import gc
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from annulus_pipe.capture.proof import Witness
from annulus_pipe.link.pins import AS_WIRED, Pins
from annulus_pipe.twin.emulated import open_board
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.head import world_named
from annulus_pipe.twin.profiles import profile_of
from annulus_pipe.twin.soak_world import HEAD_WIDTH, SHOWN_MAX, SoakWorld
from annulus_pipe.vocabulary import AnnulusError

FRAMES_MIN = 100
WORLD_FRAMES = 50_000
RELOCKS_SHOWN = 5
_FOLDED = ("frames", "seed", "clock", "shown", "relocks", "z_error_max_mm", "z_assumed_error_max_mm")


def soak(
    frames: int,
    seed: int = 0,
    *,
    faults: Faults | str | Path | None = "standard",
    without: Iterable[str] = (),
    board: str = "native",
    jobs: int | None = 1,
    world_frames: int = WORLD_FRAMES,
    pins: Pins = AS_WIRED,
    trigger: str = "none",
    head: str = "",
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[str, Any]:
    """Run `frames` camera frames of virtual time and score every label and place.

    without : witnesses that are not asked: sabotage, which shows what each is good for. jobs : processes, None for one
    a core. board : native or emulated: the same core on a simulated board, or the very
    image a user flashes. pins : the head's wiring. trigger : what its camera takes. head : a world of the twin by its
    name, with all of its cameras in turn, one a world; none: a clean pipe under rings.

    Raises AnnulusError when `frames` is too few, a name is unknown, or with the emulated board where silicon would
    have hung.
    """
    if frames < FRAMES_MIN:
        raise AnnulusError(f"soak: {frames} frames, expected {FRAMES_MIN} or more")
    profile = profile_of(faults)
    unasked = _witnesses(without)
    worlds = max(1, round(frames / world_frames))
    lengths = [frames // worlds + (i < frames % worlds) for i in range(worlds)]
    orders = [
        (
            length,
            seed if worlds == 1 else 1000 * seed + i,
            profile.place(length, 1000 * seed + i),
            unasked,
            board,
            profile.ratio,
            pins,
            trigger,
            head,
        )
        for i, length in enumerate(lengths)
    ]
    began = time.perf_counter()
    many = min(jobs or os.cpu_count() or 1, worlds)
    if many == 1:
        reports, done = [], 0
        for order in orders:
            reports.append(_world(*order, _from(progress, done, frames)))
            done += order[0]
    else:
        reports = _on_processes(orders, many, progress)
    if progress is not None:
        progress("frames", frames, frames)
    return _together(frames, seed, reports, time.perf_counter() - began)


_Order = tuple[int, int, Faults, frozenset[Witness], str, int, Pins, str, str]
_Progress = Callable[[int], None] | None


def _world(
    frames: int,
    seed: int,
    faults: Faults,
    without: frozenset[Witness],
    board: str,
    ratio: int,
    pins: Pins,
    trigger: str,
    head: str,
    progress: _Progress = None,
) -> dict[str, Any]:
    opened = open_board(board)
    try:
        seen = world_named(head, seed) if head else None
        camera = seed % len(seen.cameras) if seen is not None else 0
        small = None if seen is None else seen.scaled(HEAD_WIDTH)
        world = SoakWorld(
            frames, seed, faults, opened, without, ratio, small, pins=pins, trigger=trigger, camera=camera
        )
        gc.freeze()  # all that was imported: nobody need look through it again
        for frame in range(frames):
            world.frame(frame)
            if progress is not None and frame % 100 == 0:
                progress(frame)
        world.finish()
        return world.report()
    finally:
        opened.close()


def _witnesses(names: Iterable[str]) -> frozenset[Witness]:
    try:
        return frozenset(Witness(name) for name in names)
    except ValueError as error:
        raise AnnulusError(f"soak: {error}, expected {', '.join(Witness)}") from None


def _from(progress: Callable[[str, int, int], None] | None, done: int, frames: int) -> _Progress:
    return None if progress is None else lambda frame: progress("frames", done + frame, frames)


def _on_processes(
    orders: list[_Order], jobs: int, progress: Callable[[str, int, int], None] | None
) -> list[dict[str, Any]]:
    reports = []
    frames = sum(order[0] for order in orders)
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for report in pool.map(_world, *zip(*orders, strict=True)):
            reports.append(report)
            if progress is not None:
                progress("frames", sum(r["frames"] for r in reports), frames)
    return reports


def _together(frames: int, seed: int, reports: list[dict[str, Any]], seconds: float) -> dict[str, Any]:
    """Counts added, greatest errors kept."""
    relocks = sorted((one for report in reports for one in report["relocks"]), key=lambda one: one["frames"])
    summed: dict[str, Any] = {}
    for key, value in reports[0].items():
        if key in _FOLDED:
            continue
        values = [report[key] for report in reports]
        summed[key] = _added(values) if isinstance(value, Mapping) else sum(values)
    return {
        "frames": frames,
        "seed": seed,
        "worlds": len(reports),
        **summed,
        "unknown_share": round(summed["unknown"] / frames, 5),
        "z_error_max_mm": max(report["z_error_max_mm"] for report in reports),
        "z_assumed_error_max_mm": max(report["z_assumed_error_max_mm"] for report in reports),
        "relock_frames_max": relocks[-1]["frames"] if relocks else 0,
        "relock_frames": dict(sorted({one["kind"]: one["frames"] for one in relocks}.items())),
        "relock_worst": relocks[: -RELOCKS_SHOWN - 1 : -1],
        "relock_mixed": {
            "disturbances": len(relocks),
            "mixed": sum(one["whole"] > one["frames"] for one in relocks),
            "worst": max(relocks, key=lambda one: one["whole"], default=None),
        },
        "clock": max((report["clock"] for report in reports), key=lambda clock: abs(clock["drift_ppm"])),
        "wrong_ones": [one for report in reports for one in report["shown"]][:SHOWN_MAX],
        "virtual_s": round(frames / 25.0, 1),
        "seconds": round(seconds, 2),
    }


def _added(counts: list[Mapping[str, Any]]) -> dict[str, Any]:
    total: Counter[str] = Counter()
    nested: dict[str, list[Mapping[str, Any]]] = {}
    for one in counts:
        for key, value in one.items():
            if isinstance(value, Mapping):
                nested.setdefault(key, []).append(value)
            else:
                total[key] += value
    return {**total, **{key: _added(values) for key, values in nested.items()}}
