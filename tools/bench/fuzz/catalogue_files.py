"""Results that somebody adds to a catalogue, made wrong.

Its own Parquet files are DuckDB's and PyArrow's to read, which reserve more room than a reader may have here;
tests/unit/archive damages those.
"""

import tempfile
from datetime import datetime
from functools import cache
from pathlib import Path
from random import Random

from annulus_pipe.archive.catalogue.survey import read_survey
from annulus_pipe.untrusted import parse_json
from tools.bench.fuzz.mutate import HOSTILE, as_json, of_bytes, of_rows, of_values
from tools.bench.speed.catalogue import results


@cache
def _whole() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as name:
        return {file.name: file.read_bytes() for file in results(Path(name), "P", datetime(2026, 5, 4), 8).iterdir()}


def catalogue_case(rng: Random) -> bytes:
    name = rng.choice(tuple(_whole()))
    data = _whole()[name]
    if name == "summary.json" and rng.random() < 0.8:
        made = as_json(rng, of_values(rng, parse_json(data, len(data)), HOSTILE))
    elif name == "stations.csv" and rng.random() < 0.5:
        made = of_rows(rng, data.decode()).encode("utf-8", "surrogatepass")
    else:
        made = of_bytes(rng, data)
    return name.encode() + b"\0" + made


def catalogue_read(data: bytes, folder: Path) -> None:
    name, _, content = data.partition(b"\0")
    for file, whole in _whole().items():
        (folder / file).write_bytes(content if file == name.decode() else whole)
    read_survey(folder)
