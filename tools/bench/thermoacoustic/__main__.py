"""Regenerates RESULTS.md and pictures/: `make bench-thermoacoustic`, or `python tools/bench/thermoacoustic [TOPIC ..]`.

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
    "templates": "Codes and templates (§8.2)",
    "solver": "Sound: the solver (§7.6)",
    "imaging": "Images from 50 angles (§8.3)",
    "microwaves": "Microwaves: where the power stays (§7.8.2)",
    "coded": "Coded against single, same noise (Tables 8.1 to 8.3)",
    "wires": "Two wires in agar, resolution (Fig. 8.13, 8.14)",
}


def section(title: str, rows: list[Row]) -> list[str]:
    lines = [f"## {title}", "| what | source | theory | asked | this project | |", "|---|---|---|---|---|---|"]
    for row in rows:
        mark = {True: "met", False: "**missed**", None: ""}[row.ok]
        lines.append(f"| {row.what} | {row.source} | {row.theory} | {row.target} | {row.measured} | {mark} |")
    return [*lines, ""]


def main(wanted: list[str]) -> int:
    unknown = set(wanted) - set(TOPICS)
    if unknown:
        print(f"no such topic: {', '.join(sorted(unknown))}; there are {', '.join(TOPICS)}", file=sys.stderr)
        return 2
    text: list[str] = []
    missed = 0
    for topic in wanted or TOPICS:
        began = time.monotonic()
        print(f"== {topic}", flush=True)
        module = importlib.import_module(topic)
        rows = module.rows()
        missed += sum(row.ok is False for row in rows)
        lines = section(TOPICS[topic], rows)
        if hasattr(module, "NOTE"):
            lines[1:1] = [module.NOTE.strip(), ""]
        print("\n".join(lines), f"{time.monotonic() - began:.0f} s", flush=True)
        text += lines
    if not wanted:
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
        head = [
            "# Thermoacoustics: the source's numbers, what theory allows, and ours",
            f"Made by `make bench-thermoacoustic` at {commit.stdout.strip()}, Python {platform.python_version()}, "
            f"{platform.machine()}. Do not edit. Pictures: [pictures/](pictures).",
            "",
        ]
        (HERE / "RESULTS.md").write_text("\n".join([*head, *text]))
    print(f"{missed} rows miss their target" if missed else "every target met")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
