"""Cross bores of a recorded scan: what its capacitive sectors read, its odometer, its roll and its rings' poses say.

The rings know where the head stood off the pipe's axis, and where the pipe has joints: lift-off is taken out, and a
joint is no sewer.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.numeric.rounding import DISTANCE, quoted
from annulus_pipe.record.recording import Recording
from annulus_pipe.scans.scan import Scan
from annulus_pipe.sensors.fdc2214 import CHANNELS, LOSSES
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.vocabulary import AnnulusError, Finding
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wings.crossbore.lane import Lane, LaneMark
from annulus_pipe.wings.crossbore.measure import (
    BORES,
    BoreDetections,
    BoreIndication,
    CapacitiveHead,
    Passage,
    PipeGrid,
    Run,
    detect,
    likely,
    on_grid,
)

WING = "crossbore"
ODOMETER, ROLL, SECTORS_OF = "z_mm", "roll_deg", "sectors"
TOPIC = "/sensor/"
FIRST = 10  # records of a topic that are looked at


def with_bores(survey: Survey, scan: Scan, profiles: Sequence[Profile]) -> Survey:
    """The same survey with its lane and its cross bores among the features; itself where no sectors were recorded."""
    recording = scan.recording
    if recording is None or not any(_of_sectors(recording, topic) for topic in recording.topics):
        return survey
    configured = (recording.configuration or {}).get(SECTORS_OF)
    head, ahead = _head(configured if isinstance(configured, Mapping) else {})
    passage = Passage(ahead)
    for topic in recording.topics:
        if topic.startswith(TOPIC):
            for body in recording.notes(topic):
                try:
                    sample = Sample.from_dict(body)
                except ValueError:
                    continue
                take(passage, sample)
    for profile in profiles:
        take_pose(passage, profile, ahead)
    runs = passage.runs()
    joints = [f.z_mm for f in survey.features if f.kind in (FeatureKind.JOINT, FeatureKind.GAP)]
    lane, features, findings = None, list(survey.features), list(survey.disbelieved)
    if not runs:
        why = "no stretch of pipe with a place where more than half of the rows hold readings of all sectors"
        findings.append(Finding("sectors", f"capacitive sectors: {why}; cross bores were not looked for"))
    for run in runs:
        try:
            grid = on_grid(run.log, head)
            account = detect(grid, head, joints_mm=joints)
        except AnnulusError as error:  # the wall is told all the same
            findings.append(Finding("sectors", f"capacitive sectors: {error}"))
            continue
        findings += [Finding("sectors", f"capacitive sectors: no readings of {gap}") for gap in account.gaps]
        features += [_feature(one, grid, run.rolled_at(one.odometer_mm)) for one in account.bores]
        more = _lane(account, grid, run)
        lane = more if lane is None else lane.joined(more)
    beside = {} if lane is None else {WING: lane}
    features.sort(key=lambda one: (one.z_mm, one.clock_deg))
    return replace(survey, features=tuple(features), disbelieved=tuple(findings), beside={**survey.beside, **beside})


def _of_sectors(recording: Recording, topic: str) -> bool:
    """Whether a topic carries sectors' readings, by its first records: it may have a third of a million an hour."""
    first = islice(recording.notes(topic), FIRST) if topic.startswith(TOPIC) else ()
    values = (body.get("values") for body in first if isinstance(body, Mapping))
    return any(isinstance(named, Mapping) and CHANNELS[0] in named for named in values)


def take(passage: Passage, sample: Sample) -> bool:
    """What concerns a passage in a sample, whichever sensor's; whether it was a reading of the sectors."""
    t_s, values = 1e-9 * sample.host_ns, sample.values
    if ROLL in values and sample.units[ROLL] == "deg":
        passage.roll(t_s, values[ROLL])
    if sample.sensor == "odometer" and ODOMETER in values:
        passage.place(t_s, values[ODOMETER])
    if not all(sample.units.get(name) == "pF" for name in CHANNELS):
        return False
    loss = [values[name] for name in LOSSES] if all(name in values for name in LOSSES) else ()
    passage.read(t_s, [values[name] for name in CHANNELS], loss)
    return True


def _head(configured: Mapping[str, Any]) -> tuple[CapacitiveHead, float]:
    """The head that a recording's configuration describes; anything that describes none is passed over."""
    usual = CapacitiveHead()
    try:
        air_pf = untrusted.within(configured.get("air_pf", usual.air_ff / 1000), "air_pf", 0.01, 1e3)
        coupling_ff = untrusted.within(configured.get("coupling_ff", usual.coupling_ff), "coupling_ff", 1.0, 1e4)
        ahead = untrusted.within(configured.get("ahead_mm", 0.0), "ahead_mm", -2000.0, 2000.0)
        return replace(usual, air_ff=1000 * air_pf, coupling_ff=coupling_ff), ahead
    except ValueError:
        return usual, 0.0


def take_pose(passage: Passage, profile: Profile, ahead_mm: float) -> None:
    """Where the rings saw the head."""
    if profile.pose is not None and math.isfinite(profile.z_mm):
        x, y = profile.pose.to_pipe(np.array([[0.0, 0.0, ahead_mm]]))[0, :2]
        passage.off(profile.z_mm, float(x), float(y))


def _feature(one: BoreIndication, grid: PipeGrid, rolled: bool) -> Feature:
    clock, arc = ((one.phi_deg + 90.0) % 360, one.arc_deg) if rolled and math.isfinite(one.phi_deg) else (0.0, 360.0)
    measures = [FeatureMeasure("probability_percent", round(100 * likely(one), 1))] if one.odds else []
    sector = _sector(one, grid)
    strongest = float(one.change_ff[int(np.argmax(np.abs(one.change_ff)))])
    measures.append(FeatureMeasure("change_ff", strongest))
    if arc < 360.0:
        measures.append(FeatureMeasure("towards_deg", clock, 2 * one.phi_sigma_deg))
    where = f"sector {sector}" if sector else "all sectors"
    how = "" if rolled else "; the head's roll is not known, and so no direction"
    fill = {"part": "air above water"}.get(str(one.kind), str(one.kind))
    return Feature(
        FeatureKind.CROSS_BORE, one.odometer_mm, one.extent_mm, clock, arc, tuple(measures), f"{fill}, {where}{how}"
    )


def _sector(one: BoreIndication, grid: PipeGrid) -> int:
    """Number, from 1, of the sector that sees most of it; 0 where all see as much."""
    return 0 if not math.isfinite(one.phi_deg) else 1 + int(np.argmax(np.abs(one.change_ff)))


def _lane(account: BoreDetections, grid: PipeGrid, run: Run) -> Lane:
    marks = tuple(
        LaneMark(
            str(one.kind),
            one.odometer_mm,
            one.extent_mm,
            one.kind in BORES,
            _sector(one, grid),
            one.phi_deg if run.rolled_at(one.odometer_mm) else math.nan,
            likely(one),
        )
        for one in account.indications
    )
    blind = account.length_mm - account.water_told_mm
    remark = f"The first and last {quoted(account.ends_mm, DISTANCE)} are not judged."
    if blind > 100.0:
        remark += f" Water cannot be told on {quoted(blind, DISTANCE)}."
    if account.wanders:
        remark += " The head wandered: only what is alike all round is called a bore."
    lift = "taken out by the rings' poses" if grid.lift_ff_mm is not None else "left in: too few frames had a pose"
    return Lane(grid.z_mm, grid.c_ff / 1000, grid.seen, marks, f"{remark} Lift-off is {lift}.")
