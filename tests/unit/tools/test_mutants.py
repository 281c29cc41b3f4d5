"""A promise of `make mutants`: each fault changes a line that is there, and asks a test that is there."""

import subprocess
import sys
import tomllib
from pathlib import Path

from _pytest.mark.expression import Expression

ROOT = Path(__file__).resolve().parents[3]


def test_every_mutant_changes_a_line_and_asks_a_test() -> None:
    asked = [sys.executable, "-m", "pytest", "--collect-only", "--no-header", "tests/emulator"]
    listed = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False)
    assert "::" in listed.stdout, listed.stdout + listed.stderr
    names = [line.lower() for line in listed.stdout.splitlines() if "::" in line]
    amiss = []
    for mutant in tomllib.loads((ROOT / "tools/mutants.toml").read_text(encoding="utf-8"))["mutant"]:
        expression = Expression.compile(mutant["tests"])
        if not any(expression.evaluate(lambda word, name=name, **_: word.lower() in name) for name in names):
            amiss.append(f"{mutant['name']}: no test is chosen by {mutant['tests']!r}")
        if mutant["right"] not in (ROOT / "firmware" / mutant["file"]).read_text(encoding="utf-8"):
            amiss.append(f"{mutant['name']}: the line it changes is gone")
    assert amiss == []
