"""Breaks the host's Python at places drawn from a seed, one at a time, and says which tests notice.

python -m tools.breakages --seed 7 --count 20          the tests of the room first, then the rest of the gate
python -m tools.breakages --seed 7 --list              only say what would be broken
python -m tools.breakages --seed 7 --room-only         the tests of the room, no more: minutes in place of hours
python -m tools.breakages --seed 7 --deep              what the gate lets pass, before the deep tests as well

Each fault is made in a copy of the checkout. `tools/mutants.py` does the same to the firmware, by faults with names.
"""

import argparse
import ast
import copy
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NOT_OURS = ("link/messages.py", "/controller.py", "__main__.py")  # generated
STAGE_S = 1800.0  # a stage that takes longer hangs, and that is noticed
TURNED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Breakage:
    """One node gone wrong: its file, its line, both texts, and the file's text with it."""

    file: str
    line: int
    was: str
    now: str
    source: str

    @property
    def room(self) -> str:
        return self.file.removeprefix("host/annulus/").partition("/")[0].removesuffix(".py")


def wrong(node: ast.AST) -> ast.AST | None:
    """The node with a fault in it, or None where this kind of node has none."""
    other = copy.deepcopy(node)
    match other:
        case ast.Compare(ops=[op, *rest]) if type(op) in TURNED:
            other.ops = [TURNED[type(op)](), *rest]  # type: ignore[list-item]
        case ast.BinOp(op=op) | ast.BoolOp(op=op) if type(op) in TURNED:
            other.op = TURNED[type(op)]()  # type: ignore[assignment]
        case ast.Constant(value=bool() as value):
            other.value = not value
        case ast.Constant(value=int() as value):
            other.value = value + 1
        case ast.Constant(value=float() as value):
            other.value = 1.5 * value + (value == 0.0)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return operand
        case ast.IfExp(test=test):
            other.test = ast.UnaryOp(ast.Not(), test)
        case _:
            return None
    return other


def places(tree: ast.Module) -> Iterator[ast.expr]:
    """Every expression that can go wrong, but for annotations, decorators and defaults' types."""
    left = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    inside = {id(node) for function in left for statement in function.body for node in ast.walk(statement)}
    spared: set[int] = set()
    for node in ast.walk(tree):
        noted = [
            getattr(node, "annotation", None),
            getattr(node, "returns", None),
            *getattr(node, "decorator_list", []),
        ]
        spared |= {id(part) for one in noted if one is not None for part in ast.walk(one)}
        if isinstance(node, ast.JoinedStr):  # what is printed
            spared |= {id(part) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.expr) and id(node) in inside and id(node) not in spared and wrong(node) is not None:
            yield node


def drawn(sources: dict[str, str], seed: int, count: int) -> list[Breakage]:
    """`count` faults, evenly over all places of these files (name to text)."""
    rng = random.Random(seed)
    trees = {name: ast.parse(text) for name, text in sorted(sources.items())}
    everywhere = [(name, node) for name, tree in trees.items() for node in places(tree)]
    made: list[Breakage] = []
    for name, node in rng.sample(everywhere, len(everywhere)):
        if len(made) == count:
            break
        lines = sources[name].split("\n")
        if node.end_lineno != node.lineno:
            continue
        line = lines[node.lineno - 1].encode()
        was = line[node.col_offset : node.end_col_offset].decode()
        fault = wrong(node)
        assert fault is not None
        now = f"({ast.unparse(fault)})"
        lines[node.lineno - 1] = (line[: node.col_offset] + now.encode() + line[node.end_col_offset :]).decode()
        text = "\n".join(lines)
        try:
            same = ast.dump(ast.parse(text)) == ast.dump(trees[name])
        except SyntaxError:  # within an f-string, say
            continue
        if not same:
            made.append(Breakage(name, node.lineno, was, now, text))
    return made


def host_sources() -> dict[str, str]:
    listed = subprocess.run(["git", "ls-files", "host/annulus"], cwd=ROOT, capture_output=True, text=True, check=True)
    names = [name for name in listed.stdout.split() if name.endswith(".py") and not name.endswith(NOT_OURS)]
    return {name: (ROOT / name).read_text(encoding="utf-8") for name in names}


def copied(place: Path) -> Path:
    """A checkout of its own. Raises SystemExit where Python would still import ours."""
    ignored = shutil.ignore_patterns(
        ".git", ".venv", "dist", "__pycache__", "node_modules", ".mypy_cache", ".hypothesis"
    )
    other = place / "annulus"
    shutil.copytree(ROOT, other, ignore=ignored, symlinks=True)
    (other / ".venv").symlink_to(ROOT / ".venv")
    if (ROOT / "tools/emulator/node_modules").is_dir():
        (other / "tools/emulator/node_modules").symlink_to(ROOT / "tools/emulator/node_modules")
    subprocess.run(["git", "init", "-q"], cwd=other, check=True)
    subprocess.run(["git", "add", "-A"], cwd=other, check=True)
    asked = [sys.executable, "-c", "import annulus; print(annulus.__file__)"]
    imported = subprocess.run(asked, cwd=other, env=env_of(other), capture_output=True, text=True, check=True).stdout
    if not imported.startswith(str(other)):
        raise SystemExit(f"tools.breakages: annulus would be imported from {imported.strip()}, not from the copy")
    return other


def env_of(other: Path) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": f"{other / 'host'}", "PYTHONDONTWRITEBYTECODE": "1"}  # none is stale


def noticed_by(other: Path, *arguments: str) -> str:
    """The first test that fails, or "" where none does."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "auto", "--dist", "loadfile", *arguments]
    try:
        run = subprocess.run(command, cwd=other, env=env_of(other), capture_output=True, text=True, timeout=STAGE_S)
    except subprocess.TimeoutExpired:
        return f"a stage of more than {STAGE_S:g} s"
    if run.returncode in (0, 5):
        return ""
    first = re.search(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.M)
    return first.group(1) if first else (run.stdout + run.stderr).strip().splitlines()[-1]


def judged(other: Path, breakage: Breakage, *, room_only: bool, deep: bool) -> tuple[str, str]:
    """room, gate, deep or nobody; and the test that failed."""
    gate, everything = "not deep and not alone", ["tests", "--ignore", "tests/held", "--ignore", "tests/guest"]
    room = [name for kind in ("unit", "scenes") if (other / (name := f"tests/{kind}/{breakage.room}")).is_dir()]
    stages = [("room", [*room, "-m", gate])] if room else []
    if not room_only:
        stages.append(("gate", [*everything, "-m", gate]))
    if deep:
        stages.append(("deep", [*everything, "-m", "deep and not alone"]))
    for stage, arguments in stages:
        if by := noticed_by(other, *arguments):
            return stage, by
    return "nobody", ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--list", action="store_true", help="say what would be broken, and run nothing")
    parser.add_argument("--room-only", action="store_true", help="the tests of the room that is broken, no more")
    parser.add_argument("--deep", action="store_true", help="what the gate lets pass goes before the deep tests")
    asked = parser.parse_args()
    faults = drawn(host_sources(), asked.seed, asked.count)
    if asked.list:
        for fault in faults:
            print(f"{fault.file}:{fault.line}  {fault.was}  ->  {fault.now}")
        return 0
    tally = {"room": 0, "gate": 0, "deep": 0, "nobody": 0}
    with tempfile.TemporaryDirectory(prefix="annulus-breakages-") as place:
        other = copied(Path(place))
        for fault in faults:
            began = time.monotonic()
            path = other / fault.file
            path.write_text(fault.source, encoding="utf-8")
            stage, by = judged(other, fault, room_only=asked.room_only, deep=asked.deep)
            path.write_text((ROOT / fault.file).read_text(encoding="utf-8"), encoding="utf-8")
            tally[stage] += 1
            took_s = time.monotonic() - began
            print(f"{stage:6} {fault.file}:{fault.line}  {fault.was} -> {fault.now}  {by}  {took_s:.0f} s", flush=True)
    caught = tally["room"] + tally["gate"]
    print(f"{caught} of {len(faults)} noticed, {tally['room']} by their room", end="; ")
    print(f"only by deep tests {tally['deep']}; by none {tally['nobody']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
