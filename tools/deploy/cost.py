"""What a season of scans costs, from four prices that the reader brings.

    python -m tools.deploy.cost              # quantities and ratios: the manual's tables
    python -m tools.deploy.cost --core-hour .. --gb-month .. --gb-out .. --request ..     # the bill, in their currency

No price is known here: every provider and every year has its own. What is known is how much of each is needed.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

HOUR_S = 3600.0
MONTHS = 12
LINES_GBIT_S = (1, 10, 25, 100)
CORES = (1, 8, 16, 64)
INDEX_REQUESTS = 5  # of a recording, at most


@dataclass(frozen=True, slots=True)
class Season:
    """What was measured: 500 scans of 100 GB and 80 m took 54 core-hours. request_mb : four frames between two of the
    LED ring at 77 MB/s and 25 frames a second."""

    scans: int = 500
    scan_gb: float = 100.0
    scan_m: float = 80.0
    core_hours: float = 54.0
    request_mb: float = 12.0

    @property
    def gb(self) -> float:
        return self.scans * self.scan_gb

    @property
    def core_s_a_gb(self) -> float:
        return self.core_hours * HOUR_S / self.gb

    @property
    def core_mb_s(self) -> float:
        """What one core reads while it works."""
        return 1000 / self.core_s_a_gb

    @property
    def requests(self) -> float:
        return self.gb * 1000 / self.request_mb + INDEX_REQUESTS * self.scans

    def hours(self, cores: int, line_gbit_s: float) -> tuple[float, str]:
        """From the first to the last scan, and which of the two decides: all machines read over one line."""
        working, reading = self.core_hours / cores, self.gb * 8 / line_gbit_s / HOUR_S
        return max(working, reading), "cores" if working >= reading else "line"


@dataclass(frozen=True, slots=True)
class Prices:
    """In one currency. core_hour : of one core with its 2 GB. gb_month : of a GB that lies there for a month.
    gb_out : of a GB that leaves the place it lies at. request : of one read."""

    core_hour: float
    gb_month: float
    gb_out: float
    request: float


def bill(season: Season, prices: Prices) -> list[tuple[str, float]]:
    """Rows of what it costs, in the prices' currency."""
    compute, requests = season.core_hours * prices.core_hour, season.requests * prices.request
    leaving = season.gb * prices.gb_out
    return [
        ("computing it once", compute),
        ("reading it once", requests),
        ("sent out of where it lies", leaving),
        ("kept for a month", season.gb * prices.gb_month),
        ("kept for a year", season.gb * prices.gb_month * MONTHS),
        ("once, work goes to the data", compute + requests),
        ("once, data goes to the work", compute + requests + leaving),
    ]


def quantities(season: Season) -> str:
    """How much of each price's unit."""
    one = Season(1, season.scan_gb, season.scan_m, season.core_hours / season.scans, season.request_mb)
    metres = season.scan_m

    def row(what: str, price: str, of_season: float, of_scan: float) -> str:
        return f"| {what} | `{price}` | {_number(of_season)} | {_number(of_scan)} | {_number(of_scan / metres)} |"

    return "\n".join(
        [
            f"| | price | {season.scans} scans | a scan | a metre |",
            "|---|---|---|---|---|",
            row("core-hours, once", "core-hour", season.core_hours, one.core_hours),
            row("GB read, sent out if the work is elsewhere", "gb-out", season.gb, one.gb),
            row("requests, once", "request", season.requests, one.requests),
            row("GB-months, a year", "gb-month", season.gb * MONTHS, one.gb * MONTHS),
        ]
    )


def hours(season: Season) -> str:
    """How long a season takes, by cores and by the line that all of them read over."""
    rows = [
        "| the line, all machines together | feeds cores | "
        + " | ".join(f"{n} core{'s' * (n > 1)}" for n in CORES)
        + " |"
    ]
    rows.append("|---|---|" + "---|" * len(CORES))
    for line in LINES_GBIT_S:
        cells = [f"{_number(taken)} h, {why}" for taken, why in (season.hours(cores, line) for cores in CORES)]
        rows.append(f"| {line} Gbit/s | {_number(line * 1000 / 8 / season.core_mb_s)} | {' | '.join(cells)} |")
    return "\n".join(rows)


def ratios(season: Season) -> str:
    """Where two ways cost the same, as a share of the price of a core-hour."""
    same = season.core_hours / season.gb
    return "\n".join(
        [
            "| costs as much as computing the season once | where | of a core-hour's price |",
            "|---|---|---|",
            f"| sending the season out once | `gb-out` is | {_share(same)} |",
            f"| keeping it for a month | `gb-month` is | {_share(same)} |",
            f"| keeping it for a year | `gb-month` is | {_share(same / MONTHS)} |",
            f"| reading it once | `request` is | {_share(season.core_hours / season.requests)} |",
        ]
    )


def _number(value: float) -> str:
    """Three digits are what the measurements are good for."""
    rounded = float(f"{value:.3g}")
    return f"{rounded:,.0f}".replace(",", " ") if rounded >= 100 else f"{rounded:g}"


def _share(value: float) -> str:
    return f"{float(f'{value:.2g}'):.9f}".rstrip("0")


def main(given: Sequence[str] | None = None) -> None:
    usual = Season()
    parser = argparse.ArgumentParser(prog="python -m tools.deploy.cost", description="What a season of scans costs.")
    for name, what in (
        ("core-hour", "price of an hour of a core with 2 GB"),
        ("gb-month", "of a GB kept for a month"),
        ("gb-out", "of a GB that leaves where it lies"),
        ("request", "of one read; offers name a thousand or a million of them"),
    ):
        parser.add_argument(f"--{name}", type=float, help=what)
    parser.add_argument("--scans", type=int, default=usual.scans)
    parser.add_argument("--scan-gb", type=float, default=usual.scan_gb)
    parser.add_argument("--scan-m", type=float, default=usual.scan_m)
    parser.add_argument("--core-hours", type=float, default=usual.core_hours, help="of all scans, measured on a few")
    parser.add_argument("--request-mb", type=float, default=usual.request_mb)
    told = parser.parse_args(given)
    numbers = (told.scans, told.scan_gb, told.scan_m, told.core_hours, told.request_mb)
    if not all(0 < one < float("inf") for one in numbers):
        parser.error("scans, their size, length, core-hours and requests are numbers above 0")
    season = Season(*numbers)
    prices = [told.core_hour, told.gb_month, told.gb_out, told.request]
    if all(one is None for one in prices):
        print(quantities(season), hours(season), ratios(season), sep="\n\n")
        return
    if any(one is None or not 0 <= one < float("inf") for one in prices):
        parser.error("the four prices go together, none below 0")
    for what, cost in bill(season, Prices(*prices)):
        print(f"{what:<30}{cost:14.2f}")


if __name__ == "__main__":
    main()
