"""Ticks and host time map onto each other within what the round trips allow, and never across a reboot."""

import random

import numpy as np

from annulus_pipe.link.clock import DRIFT_PRIOR, FLOOR_NS, HALF_LIFE_NS, HOLD_NS, SAMPLES_MAX, SAMPLES_TO_LOCK, ClockMap

MS = 1_000_000
WRAP = 1 << 32


def feed(
    clock: ClockMap, *, start_ns: int, boot_ns: int, drift: float, count: int, every_ns: int, seed: int = 0
) -> int:
    """Round trips of 0.3 ms, now and then 20 ms and lopsided. Returns the host time of the last."""
    random_ = random.Random(seed)
    now = start_ns
    for _ in range(count):
        out = 100_000 + random_.randrange(50_000)
        back = 20 * MS if random_.random() < 0.1 else 150_000 + random_.randrange(50_000)
        tick = round((now + out - boot_ns) * (1 + drift)) // 10
        clock.sample(tick % WRAP, now, now + out + back)
        now += every_ns
    return now - every_ns


def test_maps_within_half_the_best_round_trip_through_drift_and_slow_answers() -> None:
    clock = ClockMap()
    boot_ns, drift = 10**15, 40e-6
    last = feed(clock, start_ns=boot_ns + 10**9, boot_ns=boot_ns, drift=drift, count=300, every_ns=97_300_000)
    for ahead in (-(10**9), 0, 90 * MS):
        tick = round((last + ahead - boot_ns) * (1 + drift)) // 10
        host = clock.to_host(clock.extend(tick % WRAP, last))
        assert host is not None and abs(host - (last + ahead)) < 100_000
        error = clock.error_ns(last + ahead)
        assert error is not None and abs(host - (last + ahead)) <= error
    assert abs(clock.drift - drift) < 1e-7
    assert clock.rejected == 0


def test_three_quick_samples_after_a_reset_are_enough_for_a_frame() -> None:
    clock = ClockMap()
    feed(clock, start_ns=10**9, boot_ns=0, drift=80e-6, count=SAMPLES_TO_LOCK, every_ns=4 * MS, seed=3)
    assert clock.locked
    moment = 10**9 + 40 * MS
    host = clock.to_host(clock.extend(round(moment * (1 + 80e-6)) // 10 % WRAP, moment))
    assert host is not None and abs(host - moment) < 200_000


def test_ticks_are_extended_through_every_wrap() -> None:
    clock = ClockMap()
    boot_ns = 5 * 10**14
    last = feed(clock, start_ns=boot_ns, boot_ns=boot_ns, drift=20e-6, count=2000, every_ns=97_300_000)  # 4.5 wraps
    tick = clock.to_tick(last)
    assert tick is not None and abs(tick - round((last - boot_ns) * (1 + 20e-6)) // 10) < 10_000
    back = clock.to_host(tick)
    assert back is not None and abs(back - last) < 20


def test_nothing_is_mapped_before_lock_after_restart_or_far_from_the_samples() -> None:
    clock = ClockMap()
    assert clock.to_tick(0) is None and clock.error_ns(0) is None
    last = feed(clock, start_ns=10**9, boot_ns=0, drift=0.0, count=20, every_ns=10 * MS)
    assert clock.to_tick(last + HOLD_NS + MS) is None
    assert clock.to_tick(last) is not None
    clock.restart()
    assert clock.to_tick(last) is None and not clock.locked


def test_samples_of_another_life_are_refused_and_soon_drop_the_map() -> None:
    clock = ClockMap()
    last = feed(clock, start_ns=10**9, boot_ns=0, drift=0.0, count=20, every_ns=10 * MS)
    before = clock.to_tick(last)
    assert not clock.sample(1234, last + 10 * MS, last + 10 * MS + 300_000)  # the controller has restarted unheard
    assert clock.locked and clock.to_tick(last) == before
    for later in (20, 30):
        clock.sample(1234 + later * 100_000, last + later * MS, last + later * MS + 300_000)
    assert not clock.locked and clock.rejected == 3


def test_the_line_that_goes_along_is_the_one_through_all_samples_kept() -> None:
    clock, random_ = ClockMap(), random.Random(7)
    now, kept = 10**15, []
    for _ in range(3 * SAMPLES_MAX):
        half = random_.choice([10_000, 150_000, 150_000, 9 * MS])
        tick = round(now * (1 + 40e-6) + random_.gauss(0.0, 0.3) * half) // 10
        assert clock.sample(tick % WRAP, now - half, now + half)
        kept = [*kept, (now, tick, half)][-SAMPLES_MAX:]
        now += random_.randrange(MS, 300 * MS)
    last_ns, last_tick, _ = kept[-1]
    x = np.array([host_ns - last_ns for host_ns, _, _ in kept], float)
    y = np.array([(tick - last_tick) * 10 for _, tick, _ in kept], float) - x
    w = np.array([1.0 / max(half, FLOOR_NS) ** 2 for _, _, half in kept]) * 2.0 ** (x / HALF_LIFE_NS)
    prior = (1.0 / DRIFT_PRIOR) ** 2  # of a slope of 0
    normal = [[w.sum(), (w * x).sum()], [(w * x).sum(), (w * x * x).sum() + prior]]
    offset_ns, drift = np.linalg.solve(normal, [(w * y).sum(), (w * x * y).sum()])
    assert abs(clock.drift - drift) < 1e-15
    placed = clock.to_host(clock.extend(last_tick % WRAP, last_ns))
    assert placed is not None and abs(placed - (last_ns - offset_ns)) < 1.0
    assert clock.error_ns(last_ns) == min(half for _, _, half in kept)
