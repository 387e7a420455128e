"""Blocks side by side in one law: each part keeps the template of its kind, with names of its own."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from hammerstein.escaping import C
from hammerstein.export.c_blocks import CPart, Size, Table, c_block_of
from hammerstein.hysteresis import Parallel, ParallelState

_WORD = re.compile(r"/\*.*?\*/|[A-Za-z_]\w*", re.S)  # a comment is one
_FUNCTION = re.compile(r"^static \w+ (\w+)\(", re.M)
_TYPE = re.compile(r"^\} (\w+);", re.M)
SHARED = ("ROWS",)
"""Sizes that are the same in all parts."""


@dataclass(frozen=True, eq=False)
class Beside:
    """One of several parallel parts: its template, with ``_1``, ``_2`` ... appended to each of its names.

    part : as for a single block; number : counted from 1
    """

    part: CPart
    number: int

    def named(self) -> CPart:
        """Sizes, tables and start under their new names; what the templates ask for stays with the part."""
        part = self.part

        def renamed(one: Table) -> Table:
            return Table(self._of(one.name), one.values, f"Part {self.number}. {one.what}")

        return CPart(
            sizes=tuple(
                Size(self._of(size.name), size.value, size.what)
                for size in part.sizes
                if size.name not in SHARED
            ),
            tables=tuple(map(renamed, part.tables)),
            indices=tuple(map(renamed, part.indices)),
            start={self._of(name): value for name, value in part.start.items()},
        )

    def text(self, macro: str, environment: Any, context: dict[str, Any]) -> C:
        """What a macro of its template gives."""
        template = environment.get_template(f"parts/{self.part.values['hysteresis']}.jinja")
        module = template.make_module({**context, **self.part.values})
        functions = _FUNCTION.findall(str(module.functions()))
        types = _TYPE.findall(str(module.types()))
        own = {*functions, *types, *self.part.start}
        own |= {one.name for group in (self.part.sizes, self.part.tables, self.part.indices) for one in group}
        own -= set(SHARED)
        given = str(getattr(module, macro)())
        return C(_WORD.sub(lambda word: self._of(word[0]) if word[0] in own else word[0], given))

    def _of(self, name: str) -> str:
        return f"{name}_{self.number}"


@c_block_of.register
def _(hysteresis: Parallel, state: ParallelState) -> CPart:
    """Every part by itself, and their sum."""
    both = zip(hysteresis.parts, state.parts, strict=True)
    parts = [Beside(c_block_of(part, own), n) for n, (part, own) in enumerate(both, start=1)]
    helpers = sorted({helper for one in parts for helper in one.part.values["helpers"]})
    whole = CPart(
        sizes=(Size("ROWS", hysteresis.n_outputs, "outputs of the hysteresis"),),
        values={"hysteresis": "parallel", "parts": parts, "helpers": helpers},
    )
    return sum((one.named() for one in parts), whole)
