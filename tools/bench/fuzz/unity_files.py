"""A table of digs held against a survey, and the study's file, made wrong."""

from functools import cache
from pathlib import Path
from random import Random

from annulus_pipe.qualification.digs import COLUMNS, read_digs
from annulus_pipe.qualification.matching import SurveyPlace
from annulus_pipe.qualification.trials import Pull, UnseenPlace
from annulus_pipe.qualification.unity import SurveyResults, ToolClaim, Unity, study
from annulus_pipe.qualification.unity_file import FILE, read_unity, to_dict
from tools.bench.fuzz.mutate import HOSTILE, as_json, of_bytes, of_rows, of_values

DIGS = "digs.csv"
TABLE = (
    ",".join(COLUMNS) + "\n" + "".join(f"D{i},loss,{400 * i - 20},{40 * i},{0.5 * i},0.1,20,20\n" for i in range(1, 7))
)
PLACES = tuple(
    SurveyPlace(f"D{i}", "loss", 400.0 * i, 40.0 * i, 20.0, 30.0, 0.5 * i + 0.05, 0.1, at_least=i == 3)
    for i in range(1, 10)
)
HOLE = UnseenPlace(900.0, 950.0, 0.0, 90.0)
SURVEY = SurveyResults(Pull("results", "", 0.0, 4000.0, 50.0, 0.2, holes=(HOLE,)), PLACES)
CLAIM = ToolClaim(0.8, (("", 0.2),), "as claimed")


def unity_case(rng: Random) -> bytes:
    if rng.random() < 0.5:
        wrong = (
            of_bytes(rng, TABLE.encode())
            if rng.random() < 0.5
            else of_rows(rng, TABLE).encode("utf-8", "surrogatepass")
        )
        return DIGS.encode() + b"\0" + wrong
    return FILE.encode() + b"\0" + as_json(rng, of_values(rng, to_dict(_sample()), HOSTILE))


def unity_read(data: bytes, folder: Path) -> None:
    name, _, content = data.partition(b"\0")
    path = folder / name.decode()
    path.write_bytes(content)
    made = read_unity(path) if path.name == FILE else study(SURVEY, read_digs(path), path.name, CLAIM, 300.0)
    "\n".join(made.statement()).encode()


@cache
def _sample() -> Unity:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        path = Path(folder) / DIGS
        path.write_text(TABLE, encoding="utf-8")
        return study(SURVEY, read_digs(path), DIGS, CLAIM, 300.0)
