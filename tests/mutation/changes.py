"""Single changes of a source line that a test ought to notice."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

NUMERICAL = (
    "hammerstein/hysteresis/*.py",
    "hammerstein/dynamics/*.py",
    "hammerstein/compensators/**/*.py",
    "hammerstein/identification/**/*.py",
    "hammerstein/metrics/*.py",
    "hammerstein/records/checks.py",
    "hammerstein/records/gains.py",
    "hammerstein/records/loops.py",
    "hammerstein/records/turning_points.py",
    "hammerstein/records/outliers.py",
    "hammerstein/records/record.py",
    "hammerstein/records/gains.py",
    "hammerstein/records/outliers.py",
    "hammerstein/records/turning_points.py",
    "hammerstein/signals/units.py",
    "hammerstein/experiment/measure.py",
    "hammerstein/experiment/measure.py",
    "hammerstein/experiment/simulated_identification.py",
    "hammerstein/experiment/draws.py",
    "hammerstein/blocks/limit_cycles.py",
    "hammerstein/paper/causes.py",
    "hammerstein/paper/claims.py",
    "hammerstein/paper/judgements.py",
    "hammerstein/regression/compare.py",
    "hammerstein/scenario/variation.py",
    "hammerstein/blocks/driving.py",
    "hammerstein/blocks/instruments.py",
    "hammerstein/signals/__init__.py",
    "hammerstein/model/simulation.py",
    "hammerstein/blocks/driving.py",
)
"""Where numbers are made."""

OPERATORS: dict[type[ast.AST], tuple[str, str]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Mod: ("%", "*"),
    ast.Pow: ("**", "*"),
    ast.MatMult: ("@", "*"),
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
NAMES = {
    "min": "max",
    "max": "min",
    "minimum": "maximum",
    "maximum": "minimum",
    "argmin": "argmax",
    "argmax": "argmin",
    "any": "all",
    "all": "any",
    "ceil": "floor",
    "floor": "ceil",
    "sin": "cos",
    "cos": "sin",
}
EVEN = ("min", "max", "minimum", "maximum", "isclose", "hypot", "logical_and", "logical_or")
"""Functions that do not care for the order of their arguments."""


@dataclass(frozen=True)
class Change:
    """One place of one file, and what stands there instead.

    path : from the root of the project; line : from 1; start, stop : of the text in that line
    """

    path: str
    line: int
    start: int
    stop: int
    new: str

    def applied(self, source: str) -> str:
        """Source with the change in it."""
        lines = source.split("\n")
        text = lines[self.line - 1]
        lines[self.line - 1] = text[: self.start] + self.new + text[self.stop :]
        return "\n".join(lines)

    def told(self, source: str) -> str:
        """Say where it is, with the line before and after."""
        before, after = (text.split("\n")[self.line - 1].strip() for text in (source, self.applied(source)))
        return f"{self.path}:{self.line}\n    - {before}\n    + {after}"


def changes_of(root: Path, patterns: Sequence[str] = NUMERICAL) -> list[Change]:
    """All changes of the numerical modules, in the order of their places."""
    paths = sorted({path for pattern in patterns for path in root.glob(pattern)})
    return [
        change for path in paths for change in in_source(path.relative_to(root).as_posix(), path.read_text())
    ]


def in_source(path: str, source: str) -> list[Change]:
    """Changes of one file.

    >>> [change.new for change in in_source("a.py", "y = 2 * f(a, b)")]
    ['4', '/', 'b, a']
    """
    lines = source.split("\n")
    found = set()
    for node in _running(ast.parse(source)):
        for line, start, stop, new in _of_node(node, lines):
            if lines[line - 1].isascii():  # so that columns of bytes are those of letters
                found.add(Change(path, line, start, stop, new))
    return sorted(found, key=lambda change: (change.line, change.start, change.new))


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes whose value the program works with: no docstring, annotation, message or limit of a field."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.arg | ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom):
            continue
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.FunctionDef):
            for part in (*node.args.defaults, *node.args.kw_defaults, *node.body):
                if part is not None:
                    yield from _with_children(part)
            continue
        if isinstance(node, ast.AnnAssign):
            if node.value is not None:
                yield from _with_children(node.value)
            continue
        yield from _with_children(node)


def _with_children(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.FunctionDef | ast.AnnAssign | ast.Raise | ast.Assert | ast.JoinedStr):
        yield from _running(ast.Module([node], []))  # type: ignore[list-item]
        return
    yield node
    yield from _running(node)


Place = tuple[int, int, int, str]


def _of_node(node: ast.AST, lines: Sequence[str]) -> Iterator[Place]:
    if isinstance(node, ast.BinOp):
        yield from _operator(node.op, node.left, node.right, lines)
    elif isinstance(node, ast.AugAssign):
        yield from _operator(node.op, node.target, node.value, lines)
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        yield from _operator(node.ops[0], node.left, node.comparators[0], lines)
    elif isinstance(node, ast.BoolOp):
        yield from _operator(node.op, node.values[0], node.values[1], lines)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        if node.lineno == node.operand.lineno:
            before = lines[node.lineno - 1].encode()[node.col_offset : node.operand.col_offset]
            yield node.lineno, node.col_offset, node.operand.col_offset, "(" * before.count(b"(")
    elif isinstance(node, ast.Constant):
        yield from _constant(node)
    elif isinstance(node, ast.Call):
        yield from _call(node, lines)
    elif isinstance(node, ast.Return) and isinstance(node.value, ast.BinOp | ast.Call | ast.Name):
        yield from _sign(node.value, lines)


def _operator(op: ast.AST, left: ast.AST, right: ast.AST, lines: Sequence[str]) -> Iterator[Place]:
    """The operator between two operands of one line."""
    if type(op) not in OPERATORS or left.end_lineno != right.lineno:  # type: ignore[attr-defined]
        return
    old, new = OPERATORS[type(op)]
    line, after, before = right.lineno, left.end_col_offset, right.col_offset  # type: ignore[attr-defined]
    column = lines[line - 1].find(old, after, before)
    if column >= 0:
        yield line, column, column + len(old), new


def _constant(node: ast.Constant) -> Iterator[Place]:
    value = node.value
    if isinstance(value, int) and not isinstance(value, bool):
        new = str(2 * value if value > 1 else value + 1)
    elif isinstance(value, float):
        new = repr(2.0 * value if value not in (0.0, 1.0) else value + 1.0)
    else:
        return
    yield node.lineno, node.col_offset, node.end_col_offset or node.col_offset, new


def _call(node: ast.Call, lines: Sequence[str]) -> Iterator[Place]:
    """A name for its opposite; two arguments in the place of each other, where their order counts."""
    function = node.func
    name = getattr(function, "attr", getattr(function, "id", ""))
    if name in NAMES and function.end_lineno and function.end_col_offset:
        stop = function.end_col_offset
        yield function.end_lineno, stop - len(name), stop, NAMES[name]
    for one, two in zip(node.args, node.args[1:], strict=False):
        starred = isinstance(one, ast.Starred) or isinstance(two, ast.Starred)
        if name in EVEN or starred or one.lineno != two.end_lineno:
            continue
        text = lines[one.lineno - 1]
        first, second = (text[part.col_offset : part.end_col_offset] for part in (one, two))
        between = text[one.end_col_offset : two.col_offset]
        if first != second:
            yield one.lineno, one.col_offset, two.end_col_offset or 0, f"{second}{between}{first}"


def _sign(value: ast.expr, lines: Sequence[str]) -> Iterator[Place]:
    """The sign of what a function returns."""
    if value.lineno == value.end_lineno and value.end_col_offset:
        text = lines[value.lineno - 1][value.col_offset : value.end_col_offset]
        yield value.lineno, value.col_offset, value.end_col_offset, f"-({text})"
