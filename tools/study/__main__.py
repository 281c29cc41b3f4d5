"""Draws the source's figures: `python -m tools.study [FIGURE ..] [--out FOLDER] [--json]`, FIGURE 7.3 to 8.14."""

import argparse
import json
import sys
from pathlib import Path

from annulus_pipe.cli.show import progress
from annulus_pipe.vocabulary import AnnulusError
from tools.study import chosen, study


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="tools.study", description="Without figures: all, in about two minutes.")
    parser.add_argument("figures", nargs="*", help="figures of the source, 7.3 to 8.14")
    parser.add_argument(
        "--out", "-o", type=Path, default=Path("build/study"), help="for pictures, study.csv, study.json"
    )
    parser.add_argument("--json", action="store_true", help="print the numbers as JSON")
    options = parser.parse_args(arguments)
    try:
        wanted = chosen(options.figures)
        with progress() as report:
            drawn = study(wanted, options.out, report)
    except (AnnulusError, OSError) as error:
        print(f"tools.study: {error}", file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps({one.name: {"title": one.title, **one.numbers} for one in drawn}))
        return 0
    for one in drawn:
        print(f"fig {one.name:<6} {one.title}  {one.picture}")
        for name, value in one.numbers.items():
            print(f"           {name:<28} {value:.4g}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
