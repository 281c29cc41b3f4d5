"""What a near-field scan drives, opened and closed together: a real bench by its addresses, or the twin's."""

import contextlib
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from annulus_pipe.wings.joints.linear_stage import LinearStage
from annulus_pipe.wings.joints.probe import Probe, SampleProbe, VisaProbe

TWIN_FEED_MM_MIN = 30_000.0  # a bench that nobody waits for


class Bench(NamedTuple):
    """port : of the controller, whose turntable turns the pipe."""

    port: str
    stage: LinearStage
    probe: Probe


class Addresses(NamedTuple):
    """port, stage : serial ports. probe : a VISA name, or the address of samples (ipc://, tcp://), of which `sensor` is
    read. queries : what the probe is asked for, by channel."""

    port: str
    stage: str
    probe: str
    sensor: str
    queries: Mapping[str, str]


@contextlib.contextmanager
def opened_bench(at: Addresses, axis: str, feed_mm_min: float, *, home: bool) -> Iterator[Bench]:
    """home : the stage is driven to its switch first."""
    with contextlib.ExitStack() as stack:
        stage = stack.enter_context(LinearStage(at.stage, axis=axis, feed_mm_min=feed_mm_min))
        if home:
            stage.home()
        probe: Probe = (
            SampleProbe(at.probe, at.sensor, at.queries)
            if at.probe.startswith(("ipc://", "tcp://"))
            else VisaProbe(at.probe, at.queries)
        )
        stack.callback(probe.close)
        yield Bench(at.port, stage, probe)


@contextlib.contextmanager
def twin_bench(steps_per_turn: int, axis: str, *, home: bool) -> Iterator[Bench]:
    """About a joint, with the controller's own code; it stands where it begins."""
    from annulus_pipe.twin.real_time import serving
    from annulus_pipe.wings.joints.simulated import QUERIES, bench

    with serving(bench(steps_per_turn)) as rig:
        queries = {name: query for query, name in QUERIES.items()}
        at = Addresses(rig.port_url, rig.stage_url, rig.probe_name, "", queries)
        with opened_bench(at, axis, TWIN_FEED_MM_MIN, home=home) as opened:
            yield opened
