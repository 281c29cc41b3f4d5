"""head.toml, from the code that reads it: every section and key, and what each takes, as the reader itself refuses.

What a key means, and what stands where it is left out, is said once, in the annotated head.toml of the daemon's README;
`shown` reads it there. A key that is missing there, or is no key, is an error.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from annulus_pipe.daemon import config
from annulus_pipe.job import BEFORE
from annulus_pipe.sensors.chips import CHIPS
from annulus_pipe.vocabulary import AnnulusError

README = Path(__file__).resolve().parents[2] / "host/annulus_pipe/daemon/README.md"
WITH: Mapping[str, dict[str, object]] = {"log": {"file": "head.log"}}  # what else a section needs to be looked at
LISTS = {("publish", "viewers"): "a list of public keys", ("control", "viewers"): "a list of public keys"}


@dataclass(frozen=True, slots=True)
class Shown:
    """A key as the README shows it: its value as written, and what the comment says."""

    value: str
    means: str


def shown() -> dict[tuple[str, str], Shown]:
    """(section, key) -> the README's line. Keys in comments (`# drive = 31`) are there too."""
    block = README.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    found: dict[tuple[str, str], Shown] = {}
    section, last, sections = "", None, [""]
    for line in block.splitlines():
        if head := re.match(r"\[{1,2}(\w+)\]{1,2}", line):
            section, last = head[1], None
            sections.append(section)
        elif pair := re.match(r"(#\s*)?(\w+) = (\[.*?\]|\".*?\"|[^\s#]+)\s*(?:#\s*(.*))?$", line):
            last = (section, pair[2])
            found.setdefault(last, Shown(pair[3], pair[4] or ""))
            for other in re.findall(r"also (.*)$", pair[4] or ""):
                for name in re.split(r",\s*", other):
                    found.setdefault((section, name), Shown("", f"see {pair[2]}"))
            for names in re.findall(r"(\w+) and (\w+) as above", pair[4] or ""):
                for name in names:
                    found.setdefault((section, name), Shown("", f"as of [{sections[-2]}]"))
        elif last is not None and (more := re.match(r"\s+#\s*(.*)$", line)):
            found[last] = Shown(found[last].value, f"{found[last].means} {more[1]}")
    return found


def takes(section: str, key: str) -> str:
    """What the reader says it expects there."""
    if (section, key) in LISTS:
        return LISTS[section, key]
    wanted = _refusal(section, key, {})
    if wanted == "a text":
        choice = _refusal(section, key, "?")
        return choice if choice.startswith("one of") else wanted
    if low := re.match(r"a number in (\S+?)\.\.(\S+)$", wanted):
        least, most = float(low[1]), float(low[2])
        between = min(least + 0.5, most) if most - least > 1 else least
        whole = "whole" in _refusal(section, key, between)
        text = f"{'whole number' if whole else 'number'}, {_plain(least)} to {_plain(most)}"
        bound = re.match(r"0 or a number in (\S+?)\.\.", _refusal(section, key, most * 1e-12))
        return f"0, or a number, {_plain(float(bound[1]))} to {_plain(most)}" if bound and not least else text
    return wanted


def _refusal(section: str, key: str, value: object) -> str:
    """What follows "expected" when the reader refuses that value; empty where it takes it."""
    content = {**WITH.get(section, {}), key: value}
    if section == "sensor" and key not in ("kind", "device"):
        kind = next((name for name, chip in CHIPS.items() if key in chip.settings), next(iter(CHIPS)))
        content = {"kind": kind, "device": "/dev/i2c-1", **content}
    try:
        config._checked({section: content}, Path())
    except (ValueError, AnnulusError) as error:
        return str(error).partition("expected ")[2]
    return ""


def _plain(value: float) -> str:
    return f"{value:g}" if abs(value) < 1e6 else f"{value:.0f}"


def _current(section: str, names: Sequence[str]) -> list[str]:
    """Without those that are only read."""
    return [name for name in names if section != "job" or name not in BEFORE]


def missing() -> tuple[list[str], list[str]]:
    """Keys that the README does not show, and keys it shows that the reader does not know."""
    keys = {(section, key) for section, names in config._SECTIONS.items() for key in _current(section, names)}
    told = set(shown())
    return ([f"[{s}] {k}" for s, k in sorted(keys - told)], [f"[{s}] {k}" for s, k in sorted(told - keys)])


def page() -> str:
    silent, unknown = missing()
    if silent or unknown:
        raise ValueError(f"{README}: head.toml there lacks {silent} and has {unknown}, which is no key")
    told, out = shown(), []
    for section, keys in config._SECTIONS.items():
        several = section in config._LISTS
        out.append(f"\n## \\[{section}\\]\n")
        if several:
            out.append(f"May come several times, each written `[[{section}]]`.\n")
        out.append("| key | takes | shown | |\n|---|---|---|---|")
        for key in _current(section, keys):
            one = told[section, key]
            value = f"`{one.value}`" if one.value else ""
            out.append(f"| `{key}` | {_cell(takes(section, key))} | {value} | {_cell(one.means)} |")
        if section == "sensor":
            out.append("\n" + _chips())
    return "\n".join(out) + "\n"


def _chips() -> str:
    rows = ["| kind | what its samples are called | address | settings of its own |", "|---|---|---|---|"]
    for kind, chip in CHIPS.items():
        own = ", ".join(f"`{name}`" for name in chip.settings) or "none"
        rows.append(f"| `{kind}` | `{chip.name}` | `0x{chip.address:02x}` | {own} |")
    return "\n".join(rows) + "\n"


def _cell(text: str) -> str:
    return re.sub(r"([*_<\[\]|])", r"\\\1", text) if "`" not in text else text.replace("|", "\\|")


def example() -> dict[str, object]:
    """The README's head.toml, parsed."""
    return tomllib.loads(README.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0])
