"""Words belong to floors: what a command calls an option is known to the command line alone.

A message with an option's name in it is wrong on a web page, in a notebook and in a program that calls the room below.
"""

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import annulus_pipe

HOUSE = Path(annulus_pipe.__file__).parent
ROOT = Path(__file__).resolve().parents[2]
INSTALLS = re.compile(r"\b(?:(?:pipx?|uv tool|uv)\s+(?:install|inject|add|run|upgrade|uninstall)|uvx)\b([^|;&\n`]*)")
ANOTHERS = re.compile(r"annulus(\[.*)?([=<>~!@].*)?")  # what an index answers with another project's package
ASKED = re.compile(
    r"""\b(?:version|version_of|requires|distribution|files)\(\s*["']annulus["']"""
    r"""|\b(?:from|import)\s(?:[\w, ]+, )?annulus\b"""
)
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
        if file.suffix == ".py" and not file.name.endswith("commands.py")  # a wing's own part of the command line
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


def anothers(text: str) -> list[str]:
    """What of a text has a user install or ask for `annulus`, which on the index is another project's package."""
    words = (word.strip("'\",)") for found in INSTALLS.findall(text) for word in found.split())
    return [word for word in words if ANOTHERS.fullmatch(word)] + ASKED.findall(text)


def test_no_text_installs_the_other_annulus() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    texts = {}
    for name in filter(None, listed.split("\0")):
        path = ROOT / name
        if path.is_file() and path != Path(__file__) and b"\0" not in (data := path.read_bytes()):
            texts[name] = data.decode("utf-8", "replace")
    assert not {name: wrong for name, text in texts.items() if (wrong := anothers(text))}


def test_the_other_annulus_is_noticed_however_it_is_asked_for() -> None:
    for text in (
        "pip install annulus",
        "`pip install -U 'annulus[console]'`",
        "pipx install annulus==1.0.4",
        "uvx annulus demo",
        "uv add annulus>=1",
        "f\"{bin}/pip install 'annulus[{extra}]'\"",
        "pipx inject annulus cvxpy",
        'metadata.version("annulus")',
        "from annulus import wall",
        "import annulus",
    ):
        assert anothers(text), text
    for text in (
        "pip install annulus-pipe",
        "pip install './annulus_pipe-0.1.0.whl[pi]'",
        "pipx inject annulus-pipe x",
        "python3 -m venv annulus && annulus/bin/pip install ./annulus_pipe-..whl",
        "import annulus_pipe",
        "uv sync",
    ):
        assert not anothers(text), text
