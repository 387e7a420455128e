"""Write one page a module from its docstrings, by pdoc: ``reference.py FOLDER MODULE...``."""

from __future__ import annotations

import importlib
import inspect
import sys
import warnings
from pathlib import Path

import pdoc
from pdoc.doc_types import resolve_annotations
from pdoc.extract import walk_specs


def main(folder: Path, names: list[str]) -> None:
    """Write the pages; what pdoc cannot read of ours is a mistake."""
    for told in ("Error parsing type annotation .* for hammerstein", "The module specification"):
        warnings.filterwarnings("error", message=told)
    for name in names:
        resolve_named_tuples(name)
    pdoc.render.configure(docformat="numpy", math=True, show_source=False)
    pdoc.pdoc(*unreached(names), output_directory=folder)


def unreached(names: list[str]) -> list[str]:
    """Names without those that a package before them brings."""
    specs: list[str] = []
    found: set[str] = set()
    for name in sorted(names):
        if name not in found:
            specs.append(name)
            found |= set(walk_specs([name]))
    return specs


def resolve_named_tuples(module: str) -> None:
    """Put types in the place of their names, which pdoc looks up where ``__new__`` was made up."""
    home = importlib.import_module(module)
    for _, kind in inspect.getmembers(home, inspect.isclass):
        if kind.__module__ == module and issubclass(kind, tuple) and hasattr(kind, "_fields"):
            made = kind.__new__
            made.__annotations__ = resolve_annotations(made.__annotations__, home, None, kind.__name__)


main(Path(sys.argv[1]), sys.argv[2:])
