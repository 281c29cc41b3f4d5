"""A spool of 5 m had 699 small holes, the 299 smallest in one row from its first to its last millimetre, all round:
every one of 60 defects, 50 of them listed, was "not seen", and a dig anywhere said nothing."""

import json
from pathlib import Path
from typing import cast

from drawn_study import listed, write_results
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.report.summary import _hole
from annulus_pipe.storage.results_folder import read_summary, unseen
from annulus_pipe.wall.unjudged import LISTED_MAX, OF_HOLES, Unjudged, _bounded


def test_small_holes_in_one_row_hide_nothing_between_them(tmp_path: Path) -> None:
    holes = [Unjudged(OF_HOLES, "dark", 100.0 + z, 104.0 + z, 7.0 * z % 360, 4.0) for z in range(LISTED_MAX + 99)]
    rows = _bounded(holes)
    assert [row.more for row in rows if row.more] == [99] and len(rows) == LISTED_MAX + 1
    laid = [(200.0 + 80 * i, 40.0 * i, 1.0 + 0.1 * i) for i in range(6)]
    write_results(tmp_path / "out", 152.4, {}, [listed(*one) for one in laid[:4]], stations=120)
    file = tmp_path / "out/summary.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"not_seen": [_hole(row) for row in rows]}))
    assert len(unseen(read_summary(tmp_path / "out"))) == LISTED_MAX
    rows_csv = [f"{i},loss,{z},{clock},{depth},20,20" for i, (z, clock, depth) in enumerate(laid)]
    truths = tmp_path / "spool.csv"
    truths.write_text("name,kind,z_mm,clock_deg,depth_mm,length_mm,width_mm\n" + "\n".join(rows_csv) + "\n")
    done = CliRunner().invoke(
        app, ["pod", "match", str(truths), str(tmp_path / "out"), "-o", str(tmp_path / "trials.json"), "--json"]
    )
    assert done.exit_code == 0, done.exception
    found = cast(dict[str, int], json.loads(done.stdout))
    assert (found["detected"], found["missed"], found["not_seen"]) == (4, 2, 0)
