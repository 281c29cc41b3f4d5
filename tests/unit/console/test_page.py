"""The page's files: what they say in every language, where they reach, and that they round as the report does."""

import json
import math
import random
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

import annulus_pipe.console
from annulus_pipe.numeric import rounding
from annulus_pipe.numeric.rounding import Quantity

STATIC = Path(annulus_pipe.console.__file__).with_name("static")
OWN = sorted(path for path in STATIC.rglob("*") if path.is_file() and "vendor" not in path.parts)
MODULES = [path for path in OWN if path.suffix == ".js"]
QUANTITIES = {
    name: quantity
    for name in ("DISTANCE", "MEASURE", "EXTENT", "ANGLE", "ARC", "PERCENT", "SHARE")
    if isinstance(quantity := getattr(rounding, name), Quantity)
}
SEED = 18
ELSEWHERE = re.compile(rb"https?://[^\s\"'`)>]+|[\"'`]//[a-z]")
NAMESPACES = (b"http://www.w3.org/2000/svg", b"http://www.w3.org/1999/xhtml")


def strings(language: str) -> dict[str, str]:
    return dict(json.loads((STATIC / f"strings/{language}.json").read_text(encoding="utf-8")))


def test_every_language_has_every_string_and_the_same_blanks_in_it() -> None:
    english = strings("en")
    for path in (STATIC / "strings").glob("*.json"):
        other = strings(path.stem)
        assert other.keys() == english.keys(), path.name
        assert not [key for key, text in other.items() if not text.strip() and not key.startswith("unit.")], path.name
        blanks = {key: sorted(re.findall(r"{\w+}", text)) for key, text in other.items()}
        assert blanks == {key: sorted(re.findall(r"{\w+}", text)) for key, text in english.items()}, path.name


def test_every_string_that_a_module_asks_for_is_there() -> None:
    english = strings("en")
    asked = {
        key
        for path in (*MODULES, STATIC / "index.html")
        for line in path.read_text(encoding="utf-8").splitlines()
        if not line.lstrip().startswith("//")
        for key in re.findall(r"(?:\bt\(|data-t=|data-t-label=)\"([\w.-]+)\"", line)
    }
    assert asked
    assert sorted(asked - english.keys()) == []


def test_nothing_of_the_page_names_another_machine() -> None:
    named = {
        f"{path.relative_to(STATIC)}: {found.decode()}"
        for path in OWN
        for found in ELSEWHERE.findall(path.read_bytes())
        if not found.startswith(NAMESPACES)
    }
    assert named == set()


def test_no_markup_has_a_script_or_a_style_in_it_which_the_content_policy_would_refuse() -> None:
    for path in OWN:
        text = path.read_text(encoding="utf-8")
        if path.suffix in (".html", ".svg"):
            assert not re.search(r"<script(?![^>]*\ssrc=)|<style|\sstyle=|\son\w+=", text), path.name
        if path.suffix == ".js":
            assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(", text), path.name


def test_what_was_taken_from_elsewhere_has_its_licence_and_its_version_beside_it() -> None:
    folders = sorted(path for path in (STATIC / "vendor").iterdir())
    assert [folder.name for folder in folders] == ["three", "uplot"]
    for folder in folders:
        assert "Permission is hereby granted" in (folder / "LICENSE").read_text(encoding="utf-8")
        assert re.match(r"\w+ \d+\.\d+\.\d+, ", (folder / "VERSION").read_text(encoding="utf-8"))
    said = re.match(r"three 0\.(\d+)\.", (folders[0] / "VERSION").read_text(encoding="utf-8"))
    core = (folders[0] / "three.core.min.js").read_text(encoding="utf-8")
    assert said and f'"{said[1]}"' in core[:400]


def values() -> list[float]:
    """Ties at every decimal, what binary fractions make of them, sizes from 1 um to 1 km, and chance."""
    rng = random.Random(SEED)
    ties = [k / 2000 for k in range(-400, 400)] + [k + 0.5 for k in range(-50, 50)] + [k / 200 for k in range(400)]
    near = [math.nextafter(one, math.inf) for one in ties[:400]] + [math.nextafter(one, -1e9) for one in ties[:400]]
    chance = [rng.choice((-1, 1)) * 10 ** rng.uniform(-9, 6) for _ in range(2000)]
    made = [0.1 + 0.2, 1.005, 2.675, 1e15, 1e-7, 5e-324, 123456789.125, -0.0, 0.0, 0.0005, -0.0004]
    return ties + near + chance + made


def asked() -> list[tuple[str, float, str, float | None, bool]]:
    """(what, value, quantity, k2, at least)."""
    rng = random.Random(SEED)
    names = list(QUANTITIES)
    out: list[tuple[str, float, str, float | None, bool]] = []
    for n, value in enumerate(values()):
        name = names[n % len(names)]
        out.append(("digits", value, name, None, False))
        out.append(("digitsK2", abs(value), name, None, False))
        out.append(("quoted", value, name, rng.choice((None, abs(rng.gauss(0, 0.1)))), rng.random() < 0.2))
        out.append(("clockFace", value, name, None, False))
    return out + [("clockFace", k * 1.25 - 400, "ARC", None, False) for k in range(800)]


def answer(what: str, value: float, name: str, k2: float | None, at_least: bool) -> str:
    quantity = QUANTITIES[name]
    said: dict[str, Any] = {
        "digits": lambda: rounding.digits(value, quantity),
        "digitsK2": lambda: rounding.digits_k2(value, quantity),
        "quoted": lambda: rounding.quoted(value, quantity, k2, at_least=at_least),
        "clockFace": lambda: rounding.clock_face(value),
    }
    return str(said[what]())


def test_the_page_rounds_every_number_as_the_report_does() -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("needs Debian's nodejs")
    program = (
        (STATIC / "rounding.js").read_text(encoding="utf-8")
        + f"""
        const quantities = {{{", ".join(QUANTITIES)}}};
        const says = {{digits, digitsK2, quoted, clockFace: (value) => clockFace(value)}};
        const asked = {json.dumps(asked())};
        console.log(JSON.stringify({{
          said: asked.map(([what, value, name, k2, atLeast]) => says[what](value, quantities[name], k2, atLeast)),
          quantities,
          unknown: [null, undefined, NaN, Infinity].map((value) => quoted(value, MEASURE)),
        }}));
    """
    )
    ran = subprocess.run([node, "--input-type=module"], input=program, capture_output=True, text=True, check=True)
    told = json.loads(ran.stdout)
    wrong = [
        (one, theirs, ours)
        for one, theirs in zip(asked(), told["said"], strict=True)
        if theirs != (ours := answer(*one))
    ]
    assert wrong == []
    assert {
        name: (one["unit"], one["places"], one.get("thousands", False)) for name, one in told["quantities"].items()
    } == {name: (one.unit, one.places, one.thousands) for name, one in QUANTITIES.items()}
    assert told["unknown"] == [None] * 4
