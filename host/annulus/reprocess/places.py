"""What is wrong with the places of a scan's frames: stretches of z that nobody counted, or that begin anew."""

import math
from collections.abc import Sequence
from itertools import groupby, pairwise

from annulus.numeric.rounding import DISTANCE, off, said, span
from annulus.record.copy import missing_of
from annulus.record.frames import Z_MAX_MM
from annulus.record.missing import missing_told
from annulus.record.scan import Scan, ScanFrame
from annulus.record.storage import Where
from annulus.vocabulary import AnnulusError, Finding, Label

LINES_MAX = 3  # of what a recording lacks, in one finding
# mm from flash to flash, over a whole scan: rings reach a few diameters ahead, and a head of a large pipe a metre. More
# is another unit, whose kilometres of empty map took minutes. Guarded by tests/regression/places_in_another_unit.
APART_MAX_MM = 2000.0


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
        where = ", ".join(f"frame {frame.index} at {said(frame.z_mm, DISTANCE)}" for frame in begun[:5])
        text = (
            f"z has {len(begun) + 1} segments, begun anew at {where}{' and more' if len(begun) > 5 else ''}: between "
            "two of them distances were not counted"
        )
        out.append(Finding("place_segments", text, tuple(frame.index for frame in begun)))
    return out
