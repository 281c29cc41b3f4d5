"""Runs a table of benchmarks: `python -m tools.bench TABLE [TOPIC ..]`, TABLE one of `TABLES`.

A whole table writes its RESULTS.md and pictures; topics named are run alone, and only printed. Ends with status 1 if a
row misses its target or a topic breaks, with 2 for a name that there is not. `python -m tools.bench fuzz` feeds the
readers with what nobody would write; see fuzz/. `python -m tools.bench scenes` scores ray-traced scans; see scenes/.
`python -m tools.bench blind` draws pipes of its own from a seed, with `--of` what other methods look at; see blind/.
"""

import importlib
import sys

from tools.bench.table import Table

TABLES = ("metrology", "thermoacoustic", "joints", "crossbore", "archive", "pod", "speed")


HELP = {"-h", "--help"}


def main(arguments: list[str]) -> int:
    """The exit status."""
    name, *topics = arguments or [""]
    if name in HELP:
        print(f"{__doc__}\nTables: {', '.join(TABLES)}; `python -m tools.bench TABLE --help` lists its topics.")
        return 0
    if name in ("fuzz", "scenes", "blind"):
        return int(importlib.import_module(f"tools.bench.{name}.run").main(topics))
    if name not in TABLES:
        print(f"table {name!r}: expected one of {', '.join(TABLES)}, and then its topics, if not all", file=sys.stderr)
        return 2
    table: Table = importlib.import_module(f"tools.bench.{name}").TABLE
    if HELP & set(topics):
        print(_topics(name, table))
        return 0
    unknown = set(topics) - set(table.topics)
    if unknown:
        print(f"no such topic: {', '.join(sorted(unknown))}; there are {', '.join(table.topics)}", file=sys.stderr)
        return 2
    return table.run(topics)


def _topics(name: str, table: Table) -> str:
    widest = max(map(len, table.topics))
    listed = [f"  {topic:{widest}}  {title}" for topic, title in table.topics.items()]
    example = f"Example: python -m tools.bench {name} {next(iter(table.topics))}"
    made = f"; all of them: {table.made_by}" if table.made_by else ""
    return "\n".join([table.title, "", f"Topics, which may be named to run them alone{made}:", *listed, "", example])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
