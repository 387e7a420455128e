"""Upper bound of the operations of a step, from the C code itself, and the same code with a counter.

An operation is an operator of C that computes, compares or stores: + - * / and their like, a comparison, an
assignment. Addressing (an index, a member, a pointer) and the turns of a loop over a constant count only by
the operators that they write down. Structures that are copied count as one assignment.

The bound is a proof because the code is such that there is one: every loop counts up to a constant, nothing
calls itself, and nothing outside the file is called. ``Code`` refuses code that is not.
"""

import re
from functools import cached_property
from typing import Any, NamedTuple

from hammerstein.errors import InternalError

KNOWN_TYPES = "typedef int int32_t;\n"
ALIGNED = {"int": 4, "int32_t": 4, "float": 4, "double": 8}
COUNTER = "operations"
_NOT_COUNTED = {"&", "*", "sizeof"}


class Cost(NamedTuple):
    """Bytes and operations of a law.

    state_bytes : of the structure that the caller owns, with every number aligned to its size
    constant_bytes : of the tables, which stay in read-only memory
    operations : of one step, at most
    """

    state_bytes: int
    constant_bytes: int
    operations: int


class Code:
    """C code of a law, parsed.

    Parameters
    ----------
    name : of the law
    header, source : text of its two files
    """

    def __init__(self, name: str, header: str, source: str):
        from pycparser import c_parser

        self.name = name
        self._tree: Any = c_parser.CParser().parse(KNOWN_TYPES + _plain(header) + _plain(source))
        kinds = (one.type for one in self._tree.ext if type(one).__name__ == "Decl")
        enums = (kind for kind in kinds if type(kind).__name__ == "Enum")
        self._enums = {one.name: int(one.value.value) for kind in enums for one in kind.values.enumerators}
        self._functions: dict[str, Any] = {
            found.decl.name: found for found in self._tree.ext if type(found).__name__ == "FuncDef"
        }
        self._costs: dict[str, int] = {}

    def cost(self) -> Cost:
        """Bytes and operations; InternalError for code that has no bound."""
        tables = [d for d in self._tree.ext if type(d).__name__ == "Decl" and "const" in d.quals]
        constant_bytes = sum(self._size_of(table.type)[0] for table in tables)
        return Cost(self._size(self.name)[0], constant_bytes, self._function(f"{self.name}_step", ()))

    def counting(self) -> str:
        """Return the same code as one file, in which every statement adds its operations to a counter."""
        from pycparser import c_ast, c_generator

        tree = c_ast.FileAST([_counted(found) for found in self._tree.ext])
        text = str(c_generator.CGenerator().visit(tree))
        return f"#include <stdint.h>\nstatic long long {COUNTER};\n" + text.replace(KNOWN_TYPES, "", 1)

    # ---- operations ----

    def _function(self, name: str, above: tuple[str, ...]) -> int:
        if name in above:
            raise InternalError(f"exported code: {name} calls itself")
        if name not in self._functions:
            raise InternalError(f"exported code: {name} is not in the file")
        if name not in self._costs:
            self._costs[name] = self._most(self._functions[name].body, (*above, name))
        return self._costs[name]

    def _most(self, node: Any, above: tuple[str, ...]) -> int:
        """Operations of a statement or expression at most, with those of the functions that it calls."""
        kind = type(node).__name__
        if kind == "If":
            branches = [self._most(part, above) for part in (node.iftrue, node.iffalse) if part is not None]
            return self._most(node.cond, above) + max(branches)
        if kind == "For":
            turn = self._most(node.cond, above) + self._most(node.next, above) + self._most(node.stmt, above)
            return self._most(node.init, above) + self._most(node.cond, above) + self._turns(node) * turn
        if kind in ("While", "DoWhile", "Goto"):
            raise InternalError(f"exported code: a {kind} has no bound")
        total = _own(node) + sum(self._most(part, above) for _, part in node.children())
        if kind == "FuncCall":
            total += self._function(node.name.name, above)
        return total

    def _turns(self, loop: Any) -> int:
        """Turns of a loop at most, from its own words: for (int32_t i = A; (i < B) && ...; i++)."""
        counter = loop.init.decls[0]
        first = self._value(counter.init)
        ends = [part for part in _conjunction(loop.cond) if _compares(part, counter.name)]
        if len(ends) != 1 or loop.next.op != "p++" or _writes(loop.stmt, counter.name):
            raise InternalError(f"exported code: a loop over {counter.name} has no bound")
        last = self._value(ends[0].right) + (1 if ends[0].op == "<=" else 0)
        return int(max(last - first, 0))

    def _value(self, node: Any) -> int:
        """Value of an expression of constants."""
        kind = type(node).__name__
        if kind == "Constant":
            return int(node.value)
        if kind == "ID" and node.name in self._enums:
            return self._enums[node.name]
        if kind == "UnaryOp" and node.op == "-":
            return -self._value(node.expr)
        if kind == "BinaryOp" and node.op in "+-*":
            left, right = self._value(node.left), self._value(node.right)
            return {"+": left + right, "-": left - right, "*": left * right}[node.op]
        raise InternalError("exported code: a loop whose end is not a constant")

    # ---- bytes ----

    @cached_property
    def _types(self) -> dict[str, Any]:
        return {t.name: t.type for t in self._tree.ext if type(t).__name__ == "Typedef"}

    def _size(self, name: str) -> tuple[int, int]:
        """Bytes and alignment of a type by its name."""
        if name in ALIGNED:
            return ALIGNED[name], ALIGNED[name]
        return self._size_of(self._types[name])

    def _size_of(self, node: Any) -> tuple[int, int]:
        kind = type(node).__name__
        if kind == "TypeDecl":
            return self._size_of(node.type)
        if kind == "IdentifierType":
            return self._size(node.names[-1])
        if kind == "ArrayDecl":
            size, aligned = self._size_of(node.type)
            return size * self._value(node.dim), aligned
        at, widest = 0, 1
        for member in node.decls:
            size, aligned = self._size_of(member.type)
            at = -(-at // aligned) * aligned + size
            widest = max(widest, aligned)
        return -(-at // widest) * widest, widest


def _plain(text: str) -> str:
    """C without comments, preprocessor lines and the frame for C++."""
    bare = re.sub(r"/\*.*?\*/", " ", text, flags=re.S)
    bare = re.sub(r"#ifdef __cplusplus.*?#endif", "", bare, flags=re.S)
    return re.sub(r"^#.*$", "", bare, flags=re.M)


def _own(node: Any) -> int:
    """Operations of a node itself."""
    kind = type(node).__name__
    if kind == "Assignment":
        return 1 if node.op == "=" else 2
    if kind == "UnaryOp":
        return {"p++": 2, "p--": 2}.get(node.op, 0 if node.op in _NOT_COUNTED else 1)
    if kind == "Decl":
        return 1 if node.init is not None else 0
    return 1 if kind in ("BinaryOp", "TernaryOp") else 0


def _straight_of(node: Any) -> int:
    """Operations of an expression, those of the functions that it calls left out."""
    return _own(node) + sum(_straight_of(part) for _, part in node.children())


def _counted(node: Any) -> Any:
    """The same code with a count before every statement; what it is made of stays as it was."""
    from pycparser import c_ast

    kind = type(node).__name__
    if kind == "FuncDef":
        return c_ast.FuncDef(node.decl, node.param_decls, _block(node.body))
    if kind == "For":
        turn = _count(_straight_of(node.cond) + _straight_of(node.next))
        return c_ast.For(node.init, node.cond, node.next, _block(node.stmt, turn))
    if kind == "If":
        return c_ast.If(node.cond, _block(node.iftrue), node.iffalse and _block(node.iffalse))
    return node


def _block(node: Any, *first: Any) -> Any:
    """Block of statements with their counts; one statement alone, such as ``else if``, is given a block."""
    from pycparser import c_ast

    items = (node.block_items or []) if type(node).__name__ == "Compound" else [node]
    counted = [one for item in items for one in (_count(_straight(item)), _counted(item))]
    return c_ast.Compound([*first, *counted])


def _straight(item: Any) -> int:
    """Operations of a statement without the blocks inside."""
    kind = type(item).__name__
    if kind == "For":
        return _straight_of(item.init) + _straight_of(item.cond)
    return _straight_of(item.cond if kind == "If" else item)


def _count(operations: int) -> Any:
    from pycparser import c_ast

    return c_ast.Assignment("+=", c_ast.ID(COUNTER), c_ast.Constant("int", str(operations)))


def _conjunction(node: Any) -> list[Any]:
    """Parts of a condition that must all hold."""
    if type(node).__name__ == "BinaryOp" and node.op == "&&":
        return [*_conjunction(node.left), *_conjunction(node.right)]
    return [node]


def _compares(node: Any, name: str) -> bool:
    return (
        type(node).__name__ == "BinaryOp"
        and node.op in ("<", "<=")
        and getattr(node.left, "name", "") == name
    )


def _writes(node: Any, name: str) -> bool:
    """Whether a statement changes a variable."""
    kind = type(node).__name__
    taken = kind == "UnaryOp" and node.op in ("p++", "p--", "++", "--", "&")
    written = node.lvalue if kind == "Assignment" else node.expr if taken else None
    return getattr(written, "name", "") == name or any(_writes(part, name) for _, part in node.children())
