"""What a daemon says and is asked over ZeroMQ, from the code that says it: topics, fields, requests, drops."""

import ast
import inspect
import io
import re
import textwrap
import tokenize
from collections.abc import Callable, Mapping
from typing import Any

from annulus_pipe.daemon import found, live_wall, pictures, publishing
from annulus_pipe.daemon.control import REQUEST_MAX, TEXT_MAX, Do
from annulus_pipe.daemon.health import HeadHealth
from annulus_pipe.daemon.observer import Mark, Observer
from annulus_pipe.daemon.state import State
from annulus_pipe.job import JobSheet
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.wall.profile import Profile

# of frames and profiles, in the publisher's process
MADE = (pictures.preview, pictures.rows, pictures.slits, live_wall.word)
FOUND = {"defects": found.Findings.to_dict, "closeup": found.closeup}  # by the surveyor's
BYTES = {
    "frame/<camera>": "the image, row by row",
    "preview/<camera>": "the JPEG",
    "rows/<camera>": f"{pictures.BANDS} float32",
    "slits/<camera>": "x y of each point, int16, and then its ring, uint8",
    "closeup": "a PNG of the deviation around it, along the pipe to the right, clock downwards",
    "wall": "int16 rows x columns, 0.01 mm, -32768 not seen",
}
NOTES = {"frame/<camera>": "A labelled frame with its image.", "label": "The label of every frame, without its image."}
ORDER = ("frame/<camera>", "label", "profile")  # these first, the others as the code has them


def topics() -> dict[str, str]:
    """Topic -> the method of `Publishing` that sends it, as its source has them."""
    found: dict[str, str] = {}
    tree = ast.parse(textwrap.dedent(inspect.getsource(publishing.Publishing)))
    for method in ast.walk(tree):
        if not isinstance(method, ast.FunctionDef):
            continue
        for call in ast.walk(method):
            if isinstance(call, ast.Call) and getattr(call.func, "attr", "") in ("_send", "_number") and call.args:
                topic = _text(call.args[0])
                if topic:
                    found.setdefault(topic, method.name)
    return found | {_made(make): make.__name__ for make in MADE} | {topic: topic for topic in FOUND}


def _made(make: Callable[..., Any]) -> str:
    """The topic that its docstring names."""
    named = re.search(r"topic ([a-z]+(?:/<camera>)?)", inspect.getdoc(make) or "")
    assert named is not None, make
    return named[1]


def _text(node: ast.expr) -> str:
    """A topic, with what is filled in as <name>."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if not isinstance(node, ast.JoinedStr):
        return ""
    parts = []
    for part in node.values:
        if isinstance(part, ast.Constant):
            parts.append(str(part.value))
        elif isinstance(part, ast.FormattedValue):
            name = ast.unparse(part.value).rpartition(".")[2]
            parts.append("<name>" if name == "sensor" else f"<{name}>")
    return "".join(parts)


def fields_of(kind: type) -> list[tuple[str, str]]:
    """(field, the comment behind it) of a dataclass, in order."""
    source = textwrap.dedent(inspect.getsource(kind))
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    body = ast.parse(source).body[0]
    assert isinstance(body, ast.ClassDef)
    return [
        (str(ast.unparse(one.target)), comments.get(one.lineno, ""))
        for one in body.body
        if isinstance(one, ast.AnnAssign)
    ]


def keys_of(function: Callable[..., Any]) -> list[tuple[str, str]]:
    """(key, "") of every dictionary written out in a function, in order."""
    keys: dict[str, str] = {}
    for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))):
        if isinstance(node, ast.Dict):
            keys |= {str(key.value): "" for key in node.keys if isinstance(key, ast.Constant)}
    return list(keys.items())


BODIES: Mapping[str, Callable[[], list[tuple[str, str]]]] = {
    "frame/<camera>": lambda: fields_of(FrameHeader),
    "label": lambda: fields_of(FrameHeader),
    "profile": lambda: keys_of(Profile.to_dict),
    "sensor/<name>": lambda: keys_of(Sample.to_dict),
    "mark": lambda: fields_of(Mark),
    "job": lambda: fields_of(JobSheet),
    "begun": lambda: keys_of(publishing.Publishing.begun),
    "preview/<camera>": lambda: [*fields_of(FrameHeader), ("preview", "width, height"), ("published", "Unix time, s")],
    "rows/<camera>": lambda: keys_of(pictures.rows),
    "slits/<camera>": lambda: keys_of(pictures.slits),
    "wall": lambda: keys_of(live_wall.word),
    "defects": lambda: keys_of(found.Findings.to_dict),
    "closeup": lambda: [("scan", ""), *keys_of(found.closeup)],
    "state": lambda: keys_of(publishing.Publishing.state),
    "event": lambda: keys_of(publishing.Publishing.event),
    "health": lambda: keys_of(HeadHealth.to_dict),
    "ended": lambda: keys_of(publishing.Publishing.ended),
    "telemetry": lambda: [],
}


def page() -> str:
    out = []
    for topic, method in sorted(topics().items(), key=lambda one: ORDER.index(one[0]) if one[0] in ORDER else 99):
        rooms = (Observer, pictures, live_wall)
        told = FOUND.get(topic) or next((getattr(room, method) for room in rooms if hasattr(room, method)), None)
        what = NOTES.get(topic) or (inspect.getdoc(told) if told else "") or ""
        out.append(f"\n### {topic.replace('<', '&lt;').replace('>', '&gt;')}\n\n{what}\n")
        if topic == "label":
            out.append("The same fields as above, and no bytes.\n")
            continue
        if topic == "telemetry":
            out.append("One map of every counter there is; what each drop means is in [the daemon](rooms/daemon.md).\n")
            continue
        fields = BODIES[topic]()
        if any(comment for _, comment in fields):
            out.append("| field | |\n|---|---|\n" + "\n".join(f"| `{name}` | {_cell(why)} |" for name, why in fields))
        else:
            out.append("Body: " + ", ".join(f"`{name}`" for name, _ in fields) + ".")
        if topic in BYTES:
            out.append(f"\nBytes: {BYTES[topic]}.")
        out.append("")
    out.append("\n## Requests\n")
    out.append(
        f"To `[control] address`, ROUTER: a msgpack map of at most {REQUEST_MAX} bytes a request, one an answer "
        "(`ok`, `state`, `health`, `error`). `do` is one of "
        + ", ".join(f"`{do.value}`" for do in Do)
        + f"; a `mark` has a `text` of at most {TEXT_MAX} characters and may have `clock_deg`.\n"
    )
    out.append("`state` in every answer is one of " + ", ".join(f"`{state.value}`" for state in State) + ".\n")
    return "\n".join(out)


def _cell(text: str) -> str:
    return re.sub(r"([*_<|])", r"\\\1", text)
