"""Numbers by which the package decides, one table a room: ``constants.py`` prints those without a reason."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).resolve().parents[1] / "hammerstein"


class Constant(NamedTuple):
    """Numbers of a module, and the string or comment beside them that says why they are so."""

    module: str
    names: str
    value: str
    reason: str


def constants(package: Path = PACKAGE) -> Iterator[Constant]:
    """Give all numbers that modules name in capital letters; examples decide nothing."""
    for file in sorted(package.rglob("*.py")):
        if "examples" not in file.parts:
            yield from constants_of(file.read_text(encoding="utf-8"), str(file.relative_to(package)))


def constants_of(text: str, module: str) -> Iterator[Constant]:
    """Numbers of one module, with what stands beside, below, or above their block."""
    lines, body, above, end = text.splitlines(), ast.parse(text).body, "", 0
    for i, node in enumerate(body):
        named = _numbers(node)
        if not named:
            continue
        before = lines[node.lineno - 2].strip() if node.lineno > 1 else ""
        above = before.lstrip("# ") if before.startswith("#") else above if node.lineno == end + 1 else ""
        end = node.end_lineno or node.lineno
        reason = _below(body[i + 1 : i + 2]) or lines[end - 1].partition("  # ")[2] or above
        yield Constant(module, *named, reason)


def _below(following: list[ast.stmt]) -> str:
    """The string that follows, if one does."""
    for node in following:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            return " ".join(str(node.value.value).split())
    return ""


def _numbers(node: ast.stmt) -> tuple[str, str] | None:
    """Names and values of an assignment of plain numbers."""
    if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
        return None
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    parts = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
    plain = all(_is_number(part) for part in parts) and all(n.strip("_").isupper() for n in names)
    return (", ".join(names), ast.unparse(node.value)) if plain and names else None


def _is_number(node: ast.expr) -> bool:
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


if __name__ == "__main__":
    bare = [f"{c.module}: {c.names} = {c.value}" for c in constants() if not c.reason]
    sys.exit("\n".join(bare) or None)
