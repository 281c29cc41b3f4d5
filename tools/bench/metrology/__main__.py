"""Regenerates RESULTS.md and pictures/: `make bench-metrology`, or `python tools/bench/metrology [TOPIC ..]`.

Ends with status 1 if a row misses its target. Topics named on the command line are run alone and the table is printed,
not written.
"""

import importlib
import platform
import subprocess
import sys
import time

from table import HERE, ROOT, Row

TOPICS = {
    "autocalibration": "Calibration in the pipe, simulated (§4.3.2)",
    "fine_tuning": "Fine-tuning per direction (Alg. 3)",
    "calibrate_scene": "Calibration in the pipe, ray-traced",
    "intrinsics": "Camera calibration from photographs",
    "stabilisation": "Pose of the head (§3.4.3)",
    "few_rings": "Two rings, one ring, damaged rings",
    "uncertainty": "Uncertainty of a point",
    "diameter": "Diameter over repeated scans",
    "colour": "Pipes of other colours",
    "artefacts": "Artefacts, vibration, blind zones",
    "mirror": "Mirror sensor for small pipes (§3.6)",
    "pattern": "Pattern design",
    "speed": "Speed, one core",
}


def section(title: str, rows: list[Row]) -> list[str]:
    lines = [f"## {title}", "| what | source | asked | this project | |", "|---|---|---|---|---|"]
    for row in rows:
        mark = {True: "met", False: "**missed**", None: ""}[row.ok]
        lines.append(f"| {row.what} | {row.source} | {row.target} | {row.measured} | {mark} |")
    return [*lines, ""]


def main(wanted: list[str]) -> int:
    unknown = set(wanted) - set(TOPICS)
    if unknown:
        print(f"no such topic: {', '.join(sorted(unknown))}; there are {', '.join(TOPICS)}", file=sys.stderr)
        return 2
    modules = {topic: importlib.import_module(topic) for topic in wanted or TOPICS}  # all there before any runs
    text: list[str] = []
    missed = 0
    for topic, module in modules.items():
        began = time.monotonic()
        print(f"== {topic}", flush=True)
        try:
            rows = module.rows()
        except Exception as error:  # one bench that breaks must not cost the others their minutes
            rows = [Row(f"{topic} broke: {type(error).__name__}: {error}", "-", "-", "-", False)]
        missed += sum(row.ok is False for row in rows)
        lines = section(TOPICS[topic], rows)
        print("\n".join(lines), f"{time.monotonic() - began:.0f} s", flush=True)
        text += lines
    if not wanted:
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
        head = [
            "# Ring metrology: the source's numbers and ours, in the same simulation",
            f"Made by `make bench-metrology` at {commit.stdout.strip()}, Python {platform.python_version()}, "
            f"{platform.machine()}. Do not edit. Pictures: [pictures/](pictures).",
            "",
        ]
        (HERE / "RESULTS.md").write_text("\n".join([*head, *text]))
    print(f"{missed} rows miss their target" if missed else "every target met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
