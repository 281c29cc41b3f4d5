"""Words belong to floors: what a command calls an option is known to the command line alone.

A message with an option's name in it is wrong on a web page, in a notebook and in a program that calls the room below.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import annulus

HOUSE = Path(annulus.__file__).parent
OPTION = re.compile(r"(?<![\w-])--[a-z][\w-]*")
FOREIGN = {  # options of other programs that a message tells the user to run
    "--compression": "mcap compress --compression",
    "--reload": "udevadm control --reload",
    "--system-site-packages": "make the environment with --system-site-packages",
}


def options(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of every option in a literal or docstring. A literal that is an item of a list and nothing but one
    word is an argument for another program."""
    tree = ast.parse(source)
    arguments = {id(item) for node in ast.walk(tree) if isinstance(node, ast.List) for item in node.elts}
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Constant) and isinstance(node.value, str)):
            continue
        if id(node) in arguments and " " not in node.value:
            continue
        for found in OPTION.findall(node.value):
            if FOREIGN.get(found, "\n") not in node.value:
                yield node.lineno, found


@pytest.mark.parametrize("room", sorted(p.name for p in HOUSE.iterdir() if p.name not in ("cli", "__pycache__")))
def test_only_the_command_line_names_options(room: str) -> None:
    files = sorted((HOUSE / room).rglob("*.py")) if (HOUSE / room).is_dir() else [HOUSE / room]
    told = [
        f"{file.relative_to(HOUSE)}:{line}: {name}"
        for file in files
        if file.suffix == ".py"
        for line, name in options(file.read_text(encoding="utf-8"))
    ]
    assert not told


def test_the_search_sees_messages_docstrings_and_formats_but_no_arguments() -> None:
    source = '''"""See --fps."""
raise ValueError(f"{port}: give --port, not {x}", "--plain")
run([node, "--drive", *(["--vcd", str(path)] if path else [])])
text = "make the environment with --system-site-packages; a -- dash; --- a rule; well--known"
'''
    assert [name for _, name in options(source)] == ["--fps", "--plain", "--port"]
