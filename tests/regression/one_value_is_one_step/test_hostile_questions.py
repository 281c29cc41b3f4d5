"""A question limited to 5 s took 147.8 s and 12.5 GB: one value is one step to DuckDB, which looks at its interrupt and
counts its memory between vectors."""

import resource
import time
from pathlib import Path
from typing import Any

import pytest

from annulus_pipe.archive.catalogue import add, open_catalogue
from annulus_pipe.vocabulary import AnnulusError

SECONDS, MEMORY_MB = 1.0, 256
OVER = 1.5  # times the limits, at most ..
OWN_MB = 200  # .. and what the process itself needs: it was 100

HOSTILE = [
    "SELECT levenshtein(repeat('a', 100000), repeat('b', 100000))",
    "SELECT length(repeat('x', 2000000000))",
    "SELECT repeat('x', 2000000000)",
    "SELECT repeat(repeat('x', 100000), 100000)",
    "SELECT lpad('x', 2000000000, 'y')",
    "SELECT rpad('x', 2000000000, 'yz')",
    "SELECT printf('%2000000000d', 1)",
    "SELECT format('{:2000000000d}', 1)",
    "SELECT md5(repeat('x', 400000000))",
    "SELECT sha256(repeat('x', 400000000))",
    "SELECT hash(repeat('x', 400000000))",
    "SELECT upper(repeat('ä', 200000000))",
    "SELECT reverse(repeat('ä', 200000000))",
    "SELECT replace(repeat('x', 200000000), 'x', 'yyyyyyyyyy')",
    "SELECT translate(repeat('x', 200000000), 'x', 'y')",
    "SELECT to_base64(repeat('x', 500000000)::BLOB)",
    "SELECT hex(repeat('x', 500000000))",
    "SELECT bin(repeat('x', 500000000))",
    "SELECT string_split(repeat('x,', 100000000), ',')",
    "SELECT len(string_split(repeat('x,', 100000000), ','))",
    "SELECT regexp_split_to_array(repeat('x,', 100000000), ',')",
    "SELECT regexp_replace(repeat('x', 100000000), 'x', 'yyyyyyyyyyyyyyyyyyyy', 'g')",
    "SELECT regexp_matches(repeat('a', 100000000), '(a*)*b')",
    "SELECT regexp_extract_all(repeat('a', 100000000), '(a|aa)+?')",
    "SELECT regexp_matches(repeat('a', 1000), '((((a{1,100}){1,100}){1,100}){1,100})')",
    "SELECT count(*) FROM range(100000) WHERE regexp_matches(repeat('a', 100000), '(x+x+)+y')",
    "SELECT damerau_levenshtein(repeat('a', 50000), repeat('b', 50000))",
    "SELECT jaro_winkler_similarity(repeat('ab', 500000), repeat('ba', 500000))",
    "SELECT editdist3(repeat('a', 100000), repeat('b', 100000))",
    "SELECT range(1000000000)",
    "SELECT len(range(1000000000))",
    "SELECT list_sort(range(100000000))",
    "SELECT list_reverse(range(100000000))",
    "SELECT list_distinct(range(100000000))",
    "SELECT list_aggregate(range(100000000), 'sum')",
    "SELECT list_aggregate(range(100000000), 'string_agg', ',')",
    "SELECT list_aggregate(list_transform(range(100000000), lambda x: repeat('y', x)), 'max')",
    "SELECT list_transform(range(10000), lambda x: list_transform(range(100000), lambda y: x * y))",
    "SELECT list_reduce(range(100000000), lambda a, b: a + b)",
    "SELECT list_filter(range(100000000), lambda x: x % 2 = 0)",
    "SELECT flatten(list_transform(range(100000), lambda x: range(10000)))",
    "SELECT list_concat(range(100000000), range(100000000))",
    "SELECT array_to_string(list_value(repeat('x', 100000000), repeat('y', 100000000)), '')",
    "SELECT string_agg(repeat('x', 1000)) FROM generate_series(1, 100000000)",
    "SELECT list(range) FROM range(1000000000)",
    "SELECT map_from_entries(list((range, range))) FROM range(100000000)",
    "SELECT histogram(range) FROM range(100000000)",
    "SELECT count(DISTINCT range) FROM range(10000000000)",
    "SELECT count(*) FROM range(1000000) a, range(1000000) b",
    "SELECT * FROM range(1000000) a, range(1000000) b",
    "SELECT count(*) FROM range(1000000) a JOIN range(1000000) b ON a.range <> b.range",
    "SELECT a.range FROM range(1000000) a, range(1000000) b ORDER BY hash(a.range + b.range)",
    "WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t) SELECT max(n) FROM t",
    "WITH RECURSIVE t(s) AS (SELECT 'x' UNION ALL SELECT s || s FROM t) SELECT max(s) FROM t",
    "WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n FROM t, range(10)) SELECT count(*) FROM t",
    "SELECT repeat('x', 40000000) FROM range(100)",
    "SELECT repeat('x', 70000000)",
    "SELECT json_serialize_sql(repeat('(', 100000000))",
    "SELECT quantile_cont(range, 0.5) FROM range(1000000000)",
    "SELECT sum(range) OVER (ORDER BY hash(range) ROWS 1000000 PRECEDING) FROM range(100000000)",
    "SELECT count(*) FROM unnest(range(1000000000))",
    "SELECT generate_series(1, 1000000000)",
    "SELECT 2::HUGEINT ** 100000, repeat('9', 100000000)::BIGNUM",
    "SELECT factorial(100000), repeat('9', 100000000)::DOUBLE",
    "SELECT strptime(repeat('x', 500000000), repeat('%Y', 100000))",
    "SELECT " + "+".join(["1"] * 40_000),
    "SELECT " + "(" * 900 + "1" + ")" * 900,
]


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("season") / "archive"
    add(folder, [])
    return folder


def largest_child_mb() -> float:
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


@pytest.mark.alone
@pytest.mark.deep(but=1)
@pytest.mark.parametrize("sql", HOSTILE, ids=[sql[:60] for sql in HOSTILE])
def test_a_hostile_question_keeps_to_its_time_and_memory(sql: str, archive: Path, stalls: Any) -> None:
    before_mb = largest_child_mb()
    with open_catalogue(archive, MEMORY_MB) as catalogue:
        began = time.monotonic()
        with catalogue.asked("SELECT 1") as answer:  # how long a process takes to begin today
            assert list(answer.rows()) == [(1,)]
        begin_s = time.monotonic() - began
        began = time.monotonic()
        try:
            with catalogue.asked(sql, SECONDS) as answer:
                assert sum(1 for _ in answer.rows()) >= 0
        except AnnulusError as error:
            told = str(error)
            assert told.startswith("query: ") and "\n" not in told and len(told) < 600
    took_s = time.monotonic() - began
    if stalls.since(began) < 0.05:
        assert took_s < SECONDS * OVER + 2 * begin_s + 0.5
    own_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # a child begins with its parent's
    assert largest_child_mb() <= max(before_mb, own_mb, MEMORY_MB * OVER + OWN_MB)  # other tests' children were larger


def test_a_question_within_its_bounds_is_answered_after_a_hostile_one(archive: Path) -> None:
    with open_catalogue(archive, MEMORY_MB) as catalogue:
        with pytest.raises(AnnulusError, match="more than 256 MB"), catalogue.asked(HOSTILE[1]) as answer:
            list(answer.rows())
        sql = "SELECT sum(range), max(range), MAP {'x': 1.5::DOUBLE}, INTERVAL 3 DAY FROM range(100000)"
        with catalogue.asked(sql) as answer:
            ((total, last, measures, span),) = answer.rows()
    assert (total, last, measures, span.days) == (4999950000, 99999, {"x": 1.5}, 3)
