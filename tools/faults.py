"""Faults in Python's text, drawn from a seed evenly over every node that can go wrong: for tools.breakages.

A comparison turned, + to -, * to /, `and` to `or`, a number changed, `not` removed, a condition negated, None returned.
Spared: what is generated, annotations, decorators, what is said, and what runs for `__main__` or the type checker.
"""

import ast
import copy
import random
from collections.abc import Iterator
from dataclasses import dataclass
from types import CodeType

GENERATED = ("/link/messages.py", "/controller.py", "/__main__.py")  # and whatever says so of itself
MARK, MARK_WITHIN = "Do not edit", 500
SAID = {"say", "print", "echo", "debug", "info", "warning", "warn", "error", "exception", "log", "telling"}
TYPES = {"Literal", "Annotated", "TypeVar", "NewType"}
TURNED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}

Node = ast.expr | ast.stmt


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
        return self.file.removeprefix("host/annulus_pipe/").partition("/")[0].removesuffix(".py")


def _with(node: Node, **parts: object) -> Node:
    other = copy.copy(node)
    for name, part in parts.items():
        setattr(other, name, part)
    return other


def faults(node: ast.AST) -> list[tuple[Node, Node]]:
    """What of this node can be replaced by what; mostly nothing, or itself."""
    match node:
        case ast.Compare(ops=ops):
            turned = [(i, TURNED[type(op)]()) for i, op in enumerate(ops) if type(op) in TURNED]
            return [(node, _with(node, ops=[*ops[:i], op, *ops[i + 1 :]])) for i, op in turned]
        case ast.BinOp(op=op) | ast.BoolOp(op=op) | ast.AugAssign(op=op) if type(op) in TURNED:
            return [(node, _with(node, op=TURNED[type(op)]()))]
        case ast.Constant(value=bool() as value):
            return [(node, _with(node, value=not value))]
        case ast.Constant(value=int() as value):
            return [(node, _with(node, value=value + 1))]
        case ast.Constant(value=float() as value):
            return [(node, _with(node, value=1.5 * value + (value == 0.0)))]
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return [(node, operand)]
        case ast.If(test=test) | ast.IfExp(test=test):
            return [(test, ast.UnaryOp(ast.Not(), test))]
        case ast.Return(value=ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            return [(value, ast.Constant(None))]
    return []


def _name(node: ast.AST | None) -> str:
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def _spared(node: ast.AST) -> list[ast.AST | None]:
    """What below this node is not code, or not ours to judge."""
    match node:
        case ast.JoinedStr():  # what is printed
            return [node]
        case ast.Call(func=func) if _name(func) in SAID | TYPES:
            return [*node.args, *node.keywords]
        case ast.Subscript(value=value) if _name(value) in TYPES:
            return [node]
        case ast.If(test=ast.Compare(left=ast.Name(id="__name__"))):
            return [node]
        case ast.If(test=test) if _name(test) == "TYPE_CHECKING":
            return [node]
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            return [node.returns, *node.decorator_list]
        case ast.ClassDef():
            return [*node.decorator_list]
        case ast.arg() | ast.AnnAssign():
            return [node.annotation]
    return []


def places(tree: ast.Module) -> Iterator[ast.AST]:
    """Every node that can go wrong, in one order."""
    spared = {id(part) for node in ast.walk(tree) for one in _spared(node) if one is not None for part in ast.walk(one)}
    yield from (node for node in ast.walk(tree) if id(node) not in spared and faults(node))


def _essence(code: CodeType) -> tuple[object, ...]:
    """What a compiled text does, wherever it stands."""
    within = [_essence(c) if isinstance(c, CodeType) else (type(c), repr(c)) for c in code.co_consts]
    return (code.co_code, code.co_exceptiontable, code.co_names, code.co_varnames, *within)


def _compiled(text: str) -> tuple[object, ...]:
    return _essence(compile(text, "", "exec", dont_inherit=True))


def broken(file: str, text: str, target: Node, fault: Node) -> Breakage | None:
    """None where the text is then no Python, or means the same."""
    assert target.end_lineno is not None and target.end_col_offset is not None
    lines = [line.encode() for line in text.split("\n")]  # columns are counted in bytes
    first, last = target.lineno - 1, target.end_lineno - 1
    before, after = lines[first][: target.col_offset], lines[last][target.end_col_offset :]
    was, now = ast.unparse(target), ast.unparse(fault)
    put = now if isinstance(fault, ast.stmt) else f"({now})"
    changed = b"\n".join([*lines[:first], before + put.encode() + after, *lines[last + 1 :]]).decode()
    try:
        same = _compiled(changed) == _compiled(text)
    except SyntaxError:
        return None
    return None if same else Breakage(file, target.lineno, was, now, changed)


def drawn(sources: dict[str, str], seed: int, count: int) -> list[Breakage]:
    """`count` faults, evenly over all places of these files (name to text)."""
    rng = random.Random(seed)
    everywhere = [
        (name, node)
        for name, text in sorted(sources.items())
        if not f"/{name}".endswith(GENERATED) and MARK not in text[:MARK_WITHIN]
        for node in places(ast.parse(text))
    ]
    made: list[Breakage] = []
    rng.shuffle(everywhere)
    for name, node in everywhere:
        if len(made) == count:
            break
        target, fault = rng.choice(faults(node))
        if (breakage := broken(name, sources[name], target, fault)) is not None:
            made.append(breakage)
    return made
