"""What is wrong with the places of a scan's frames: stretches of z that nobody counted, or that begin anew, that run
back, and pictures that stand at two places."""

import math
from collections.abc import Sequence
from itertools import groupby, pairwise

from annulus_pipe.numeric.rounding import DISTANCE, off, quoted, span
from annulus_pipe.record.frames import Z_MAX_MM
from annulus_pipe.record.missing import missing_of, missing_told
from annulus_pipe.rings.diagnosis import FrameLighting
from annulus_pipe.scans.scan import Scan, ScanFrame
from annulus_pipe.storage.place import Where
from annulus_pipe.vocabulary import AnnulusError, Finding, Label, first_few

LINES_MAX = 3  # of what a recording lacks, in one finding
# mm from flash to flash, over a whole scan: rings reach a few diameters ahead, and a head of a large pipe a metre. More
# is another unit, whose kilometres of empty map took minutes. Guarded by tests/regression/places_in_another_unit.
APART_MAX_MM = 2000.0

# mm that z may fall behind the farthest place so far: a head at rest swings by less on its cable, and an odometer's
# wheel rocks by less. Guarded by tests/regression/odometer_that_ran_back.
BACK_MM = 3.0
SAME_MM = 0.05  # places nearer than that are one: a head at rest may be photographed twice


def require_near(path: Where, places_mm: Sequence[float]) -> None:
    """AnnulusError, one line, where flashes lie so far apart that their places cannot be mm."""
    known = [z for z in places_mm if math.isfinite(z)]
    if len(known) < 2:
        return
    length = max(known) - min(known)
    apart = length / (len(known) - 1)
    if apart > APART_MAX_MM:
        raise AnnulusError(
            f"{path}: z_mm of its {len(known)} flashes goes over {length:.0f} mm, {apart:.0f} mm from one to the next, "
            f"expected at most {APART_MAX_MM:.0f}: are these mm?"
        )


def incomplete_findings(scan: Scan) -> list[Finding]:
    """One where the recording is torn or damaged, one where the one that it was written from had lost something."""
    recording = scan.recording
    if recording is None:
        return []
    own = missing_of(recording.torn, recording.cut_frames, recording.damage)
    both = (("lacks something", own), ("was written from one that lacks something", missing_told(recording)))
    return [Finding("recording_incomplete", f"the recording {how}: {_some(lines)}") for how, lines in both if lines]


def _some(lines: Sequence[str]) -> str:
    more = f"; and {len(lines) - LINES_MAX} places more" if len(lines) > LINES_MAX else ""
    return "; ".join(lines[:LINES_MAX]) + more


def place_findings(frames: Sequence[ScanFrame]) -> list[Finding]:
    """One for each segment whose places are assumed, and one where segments do not hang together."""
    placed = [frame for frame in frames if frame.label is not Label.UNKNOWN]
    out = []
    for _, of_segment in groupby(placed, key=lambda frame: frame.segment):
        assumed = [frame for frame in of_segment if frame.z_bound_mm > 0.0]
        if assumed:
            bound = max(frame.z_bound_mm for frame in assumed)
            text = (
                f"place assumed from {span(assumed[0].z_mm, assumed[-1].z_mm, DISTANCE)}, "
                f"{'by any distance off' if bound >= Z_MAX_MM else f'± {off(bound, DISTANCE)}'}: "
                "nobody counted in a gap before"
            )
            out.append(Finding("place_assumed", text, tuple(frame.index for frame in assumed)))
    begun = [later for earlier, later in pairwise(placed) if later.segment != earlier.segment]
    if begun:
        where = ", ".join(f"frame {frame.index} at {quoted(frame.z_mm, DISTANCE)}" for frame in begun[:5])
        text = (
            f"z has {len(begun) + 1} segments, begun anew at {where}{' and more' if len(begun) > 5 else ''}: between "
            "two of them distances were not counted"
        )
        out.append(Finding("place_segments", text, tuple(frame.index for frame in begun)))
    return out


def running_back_findings(frames: Sequence[ScanFrame]) -> list[Finding]:
    """One where z falls behind the way it takes by more than a rest does, one where it takes its way backwards."""
    out, back, deepest, backwards = [], [], 0.0, []
    placed = [frame for frame in frames if frame.label is not Label.UNKNOWN and math.isfinite(frame.z_mm)]
    for _, of_segment in groupby(placed, key=lambda frame: frame.segment):
        mine = list(of_segment)
        way = -1.0 if mine[-1].z_mm < mine[0].z_mm and _falls(mine) else 1.0
        if way < 0.0:
            backwards.append((mine[0], mine[-1]))
        farthest, was_back = -math.inf, False
        for frame in mine:
            farthest = max(farthest, way * frame.z_mm)
            behind = farthest - way * frame.z_mm
            if behind > BACK_MM and not was_back:
                back.append(frame)
            was_back = behind > BACK_MM
            deepest = max(deepest, behind)
    if back:
        where = ", ".join(f"frame {frame.index} at {quoted(frame.z_mm, DISTANCE)}" for frame in back[:5])
        text = (
            f"z runs back by up to {off(deepest, DISTANCE)}, at {where}{' and more' if len(back) > 5 else ''}: unless "
            "the head went back there, the odometer slipped or was reset, and one place of the map has two of the pipe"
        )
        out.append(Finding("place_back", text, tuple(frame.index for frame in back)))
    if backwards:
        first, last = backwards[0]
        text = (
            f"z falls over the scan, from {quoted(first.z_mm, DISTANCE)} to {quoted(last.z_mm, DISTANCE)}: unless the "
            "head was drawn back, the odometer counts the wrong way, and the map is wrong along the pipe"
        )
        out.append(Finding("place_backwards", text, tuple(one.index for pair in backwards for one in pair)))
    return out


def _falls(frames: Sequence[ScanFrame]) -> bool:
    """Whether most of the way is downwards: a counter that was reset once goes up all the rest of the time."""
    steps = [later.z_mm - earlier.z_mm for earlier, later in pairwise(frames)]
    return sum(step < 0.0 for step in steps) > sum(step > 0.0 for step in steps)


def doubled_findings(frames: Sequence[ScanFrame], lights: Sequence[tuple[int, FrameLighting]]) -> list[Finding]:
    """One where pictures are those of the flash before to the bit, at another place. lights : by frame, in order."""
    place = {frame.index: frame.z_mm for frame in frames}
    twice = tuple(
        later
        for (earlier, one), (later, other) in pairwise(lights)
        if one.picture
        and one.picture == other.picture
        and not one.dark
        and abs(place.get(later, math.nan) - place.get(earlier, math.nan)) > SAME_MM
    )
    if not twice:
        return []
    text = (
        f"{len(twice)} of {len(lights)} pictures ({first_few(twice)}) are those before them to the bit, at other "
        "places: frames were doubled, or the camera stood still, and what they show stands on the map where it is not"
    )
    return [Finding("picture_doubled", text, twice)]
