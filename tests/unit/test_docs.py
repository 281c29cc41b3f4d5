"""The manual keeps its promises: every error has a family, every key and topic its line, every example can be typed."""

import importlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from annulus_pipe.daemon.config import load_config
from annulus_pipe.job import read_job
from tools.manual import commands, families, settings, topics
from tools.manual.pages import DOCS, ROOT, included, pages, whole

PAGES = sorted({*pages().values()})
OWN = sorted(page for page in (DOCS / "manual").glob("*.md") if page.name != "changelog.md")
INDENTED = re.compile(r"^    (annulus .*)$", re.M)
FENCE = re.compile(r"^[ ]*```(?:sh|bash|console|text)?\n(.*?)^[ ]*```", re.M | re.S)


def test_every_error_belongs_to_a_family_that_says_what_to_do() -> None:
    """A new AnnulusError fails here until docs/manual/families.toml says what its reader should do."""
    by, orphans, stale = families.sorted_out(families.messages())
    assert not [f"{one.module}:{one.line}: {one.template}" for one in orphans]
    assert not stale, "claims on words that no message has any more"
    assert len(families.messages()) > 500 and all(len(one.means) > 30 and len(one.do) > 15 for one in by)
    page = families.page()
    assert all(family.title in page for family in by)


@pytest.mark.parametrize(
    ("module", "template", "title"),
    [
        ("link/port.py", "{url}: cannot be opened ({why})", "The port cannot be opened, or is in use"),
        ("capture/timing.py", "{lamp} leaves the window", "A flash does not fit the window in which all rows expose"),
        ("somewhere/new.py", "the moon is full, expected a half", None),
        ("reprocess/job.py", "anything at all", "Calibration and scan do not belong together"),
    ],
)
def test_a_message_goes_to_the_first_family_that_claims_it(module: str, template: str, title: str | None) -> None:
    by, orphans, _ = families.sorted_out([families.Message(module, 1, template)])
    found = [family.title for family, mine in by.items() if mine]
    assert (found, len(orphans)) == (([title], 0) if title else ([], 1))


def test_messages_are_read_whole_from_the_source() -> None:
    of = {one.template for one in families.messages() if one.module == "capture/timing.py"}
    assert any("no moment at which all rows expose ({self})" in one for one in of)
    message = families.Message("x", 1, "{path}: holds {', '.join(names)}, {n} {what}. Expected {'a' if b else 'c'}")
    assert message.shown == "…: holds …. Expected …"


def test_head_toml_is_told_key_by_key() -> None:
    assert settings.missing() == ([], [])
    assert settings.takes("camera", "fps") == "number, 1 to 500"
    assert settings.takes("lamps", "ratio") == "whole number, 0 to 15"
    assert settings.takes("camera", "kind").startswith("one of v4l2, picamera2")
    assert settings.takes("record", "sync_s") == "0, or a number, 0.1 to 3600"
    assert settings.takes("control", "autostart") == "true or false"


def test_topics_of_the_manual_are_those_that_are_sent_and_those_of_the_readme() -> None:
    sent = set(topics.topics())
    assert sent == set(topics.BODIES)
    readme = (ROOT / "host/annulus_pipe/daemon/README.md").read_text(encoding="utf-8")
    table = readme.partition("## Published")[2].partition("\n## ")[0]
    assert sent == set(re.findall(r"^\| `([a-z]+(?:/<\w+>)?)` \|", table, re.M))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_links_lead_somewhere_and_generated_pages_can_be_made(page: Path) -> None:
    text = whole(page)
    assert text.lstrip().startswith("# ") and "<!-- include" not in text and "<!-- generated" not in text


def lines_of(text: str) -> Iterator[str]:
    """Every `annulus ..` that somebody would type: of a block, with what is joined by && taken apart."""
    for line in text.replace("\\\n", " ").splitlines():
        for part in re.split(r"&&|;| \| ", line):
            words = part.strip()
            if words.startswith("annulus "):
                yield re.split(r"\s#", words)[0]


EXAMPLES = [(f"{name}: {line}", line) for name, line in commands.examples()]
WRITTEN = [
    (f"{page.name}: {line}", line)
    for page in [*OWN, *sorted((DOCS / "manual/rooms").glob("*.md")), ROOT / "README.md"]
    for text in [page.read_text(encoding="utf-8") if page.name == "README.md" else included(page)]
    for block in [*FENCE.findall(text), *INDENTED.findall(text)]
    for line in lines_of(block)
]


def test_every_command_has_an_example() -> None:
    assert not [name for name, command in commands.tree() if not commands.is_group(command) and not command.epilog]
    assert len(EXAMPLES) > 50 and len(WRITTEN) > 60


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("what", "line"), [*EXAMPLES, *WRITTEN], ids=lambda one: one[:60])
def test_examples_can_be_typed(what: str, line: str) -> None:
    commands.parse(line)


def test_an_example_that_cannot_is_found() -> None:
    for wrong in (
        "timing --fps 25",
        "timing --fps fast --exposure-us 1 --readout-us 1",
        "record chek a.mcap",
        "reconstruct a -o b --workers 100",
        "docs --nope",
    ):
        with pytest.raises(Exception, match=r"Missing|valid number|No such|not in|less than|required"):
            commands.parse(f"annulus {wrong}")


def test_commands_named_in_passing_exist() -> None:
    known = dict(commands.tree())
    for page in OWN:
        for words in re.findall(r"`(annulus [a-z][^`]*)`", included(page)):
            name = re.match(r"annulus(?: [a-z]+)+", words)
            parts = name[0].split() if name else []
            while parts and " ".join(parts) not in known:
                parts.pop()
            command = known[" ".join(parts)]
            unknown = commands.is_group(command) and len(words.split()) > len(parts)
            assert words in ("annulus COMMAND --help",) or (len(parts) > 1 and not unknown), (page, words)


def test_doors_that_the_manual_names_are_there() -> None:
    page = (DOCS / "manual/python.md").read_text()
    named = re.findall(r"^\.\. auto(?:class|function):: (\S+)\.(\w+)$", page, re.M)
    imported = re.findall(r"^from (annulus_pipe\S*) import (\w+)$", page, re.M)
    assert len(named) > 15 and imported
    for module, name in named + imported:
        assert callable(getattr(importlib.import_module(module), name, None)), f"{module}.{name}"


def test_the_citation_has_what_its_form_needs_and_this_version() -> None:
    """Citation File Format 1.2.0: what is required of a file, of a person and of a thesis that it refers to."""
    said = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert said["cff-version"] == "1.2.0" and {"message", "title", "authors"} <= said.keys()
    assert said["version"] == tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    (thesis,) = said["references"]
    assert {"type", "title", "authors"} <= thesis.keys() and thesis["authors"][0]["family-names"] == "Alzuhiri"


def test_the_job_that_is_shown_can_be_read(tmp_path: Path) -> None:
    shown = (DOCS / "manual/results.md").read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    (tmp_path / "job.toml").write_text(shown)
    assert read_job(tmp_path / "job.toml").client == "The Waterworks"


def test_the_head_of_the_first_scan_is_one_that_is_taken(tmp_path: Path) -> None:
    shown = (DOCS / "manual/first-scan.md").read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    (tmp_path / "head.toml").write_text(shown)
    head = load_config(tmp_path / "head.toml")
    assert (
        head.port
        and head.cameras[0].kind == "picamera2"
        and (head.timing.opens_us, head.timing.closes_us) == (2000, 15000)
    )
