"""What the bench measured of each kind of head, for the page: on simulated heads, whose truth is known; once for the
kind, not for this head or scan. Every row stands in tools/bench/metrology/RESULTS.md by the title given here."""

from dataclasses import dataclass

from annulus.geometry.calibration import Calibration


@dataclass(frozen=True, slots=True)
class BenchRow:
    """words : for the page. title, value : of a row in RESULTS.md, and a piece of what it measured."""

    words: str
    title: str
    value: str


@dataclass(frozen=True, slots=True)
class Trials:
    """Defects drawn into simulated pipes, and found. title, value : as above."""

    found: int
    drawn: int
    title: str
    value: str


RINGS, STEREO, FRINGE = "rings, one camera", "rings, two cameras", "fringes in a pipe"
BENCH: dict[str, tuple[BenchRow, ...]] = {
    RINGS: (
        BenchRow("radius, rms off the truth", "pipe-a measured with that calibration", "0.0568 mm"),
        BenchRow("true radii within k = 2, one pipe", "true radii within k=2: pipe-a", "94.1 %"),
        BenchRow("true radii within k = 2, another", "true radii within k=2: twin, demo", "97.0 %"),
        BenchRow(
            "true radii within k = 2, path-traced: gloss, light from wall to wall and within it, tube, lens, dust",
            "all together, 0.2 mm between two scatterings", "96.3 %",
        ),
        BenchRow(
            "diameter of a station, mean of 20 scans, off the truth",
            "Diameter accuracy, pipe +0.5 % off nominal, 20 scans, 17 stations", "0.005 %",
        ),
        BenchRow(
            "diameter of a station, repeatability over 20 scans",
            "Diameter repeatability, pipe +0.5 % off nominal, 20 scans, 17 stations", "0.0057 %",
        ),
    ),
    STEREO: (
        BenchRow(
            "radius, rms off the truth, 6 inch", "Head of tables 5.2 to 5.4, 6-inch pipe: radius RMSE", "0.0495 mm"
        ),
        BenchRow(
            "true radii within k = 2, 6 inch; at the tangents",
            "Head of tables 5.2 to 5.4, 6-inch pipe: true radii inside k = 2, at the tangents", "96.4 %, 97.2 %",
        ),
    ),
    FRINGE: (
        BenchRow("radius, rms off the truth, 8 inch", "the scan: radius rms, aligned (before)", "0.0299"),
        BenchRow("true radii within k = 2", "k = 2 covers", "96.3%"),
    ),
}  # fmt: skip
LEFT_OPEN: dict[str, tuple[BenchRow, ...]] = {  # what k = 2 does not hold for; value : of radius, anywhere in the row
    RINGS: (
        BenchRow(
            "a translucent wall, in which light goes 1.5 mm from one scattering to the next (no pigment)",
            "wall that scatters, 1.5 mm, as without pigment", "+0.169 mm",
        ),
    ),
}  # fmt: skip
TRIALS: dict[str, Trials] = {
    RINGS: Trials(3, 3, "3-inch pipe: pocket, bump and groove found, false ones", "3, 0"),
    STEREO: Trials(5, 6, "stereo-a: defects named", "loss 0.80, loss 4.00, bump 3.95, loss 2.48, bump 2.94"),
    FRINGE: Trials(13, 13, "defects found; depths right, of 13", "13; 12"),
}


def head_kind(calibration: Calibration) -> str:
    """Which of these a calibration of rings is; "" of one that has no bench."""
    if calibration.kind != "slits":
        return ""
    return STEREO if calibration.others else RINGS
