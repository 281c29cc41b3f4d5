"""What is added to a catalogue comes out of it the same, whatever the results say."""

import shutil
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from annulus_pipe.archive.catalogue import store
from annulus_pipe.archive.catalogue.columns import STATIONS
from annulus_pipe.archive.catalogue.pieces import find, session
from annulus_pipe.archive.catalogue.store import read_back, survey_folder
from annulus_pipe.archive.catalogue.survey import read_survey
from tools.bench.speed.catalogue import results

MAY = datetime(2026, 5, 4, 8)


def texts() -> st.SearchStrategy[str]:
    return st.text(max_size=40) | st.sampled_from(
        ["'; DROP TABLE surveys; --", "<b>P</b>", '"', "[bold]", "=1+1", "P\n-\x1b[2J"]
    )


def figure(low: float = -1e6, high: float = 1e6) -> st.SearchStrategy[float]:
    return st.floats(low, high)


places = st.lists(
    st.fixed_dictionaries(
        {
            "kind": texts(),
            "z_mm": figure(),
            "length_mm": figure(0),
            "clock_deg": figure(0, 360),
            "arc_deg": figure(0, 360),
        },
        optional={
            "depth_mm": figure(0) | st.none(),
            "depth_k2_mm": figure(0),
            "area_mm2": figure(0),
            "hidden_mm": figure(0),
            "floor_seen": st.booleans(),
            "severity": texts() | st.integers(0, 9),
            "decision": texts(),
            "remark": texts(),
            "hilo_mm": figure(),
            "hilo_k2_mm": figure(0),
            "angle_deg": figure(),
        },
    ),
    max_size=4,
)
moments = st.datetimes(datetime(1970, 1, 1), datetime(2100, 1, 1)).map(str) | st.none()
summaries = st.fixed_dictionaries(
    {
        "job": st.dictionaries(st.sampled_from(["pipe", "site", "client", "operator", "remarks"]), texts()),
        "origin": st.fixed_dictionaries({"begun_utc": moments, "ended_utc": moments}),
        "created": moments,
        "defects": places,
        "undecided": places,
        "features": places,
        "points": st.integers(0, 10**12),
        "seen_percent": figure(0, 100) | st.none(),
    }
)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(summary=summaries, gaps=st.lists(st.floats(0.01, 1e4), max_size=8), seed=st.integers(0, 9))
def test_what_is_added_comes_out_the_same(
    tmp_path: Path, summary: dict[str, Any], gaps: list[float], seed: int
) -> None:
    folder, archive = tmp_path / "results", tmp_path / "archive"
    shutil.rmtree(archive, ignore_errors=True)
    results(folder, "P", MAY, len(gaps), seed, **summary)
    head, *lines = (folder / "stations.csv").read_text().splitlines()
    z = np.cumsum([0.0, *gaps])[:-1]
    for i, line in enumerate(lines):
        cells = [repr(float(z[i])), *line.split(",")[1:]]
        lines[i] = ",".join("" if j and (i + j) % 5 == 4 else cell for j, cell in enumerate(cells))
    (folder / "stations.csv").write_text("\n".join([head, *lines, ""]))
    root = store.make(archive)
    record = read_survey(folder)
    assert store.put(root, record) and not store.put(root, record)
    back = read_back(survey_folder(root, record.survey))
    assert back.row == record.row
    assert back.defects == list(record.defects) and back.features == list(record.features)
    for column in STATIONS:
        if column.kind == "number":
            np.testing.assert_array_equal(back.stations[column.name], record.stations[column.name])
    with session() as duck:  # as questions see it
        pieces = find(duck, root)
        assert duck.execute(pieces.relation("surveys")).fetchall() == [tuple(record.row.values())]
        found = duck.execute(f"SELECT z_mm FROM ({pieces.relation('stations')})").fetchall()
        assert [float(row[0]) for row in found] == list(record.stations["z_mm"])
