"""Provenance of a result: sources of the package and of plug-ins, versions of libraries, processor.

If all of these are equal, equal input gives equal bits, and a result may be reused.
"""

from __future__ import annotations

import hashlib
import platform
import sys
import uuid
from collections.abc import Iterable
from functools import cache, lru_cache
from importlib import metadata
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from hammerstein.plugins import kinds_of_others

PACKAGE = Path(__file__).parents[1]
LIBRARIES = (
    *("bokeh", "control", "jinja2", "markdown-it-py", "markupsafe", "matplotlib", "numba", "numpy", "pandas"),
    *("pillow", "pydantic", "scipy"),
)
NUMERICAL = ("numpy", "scipy", "numba", "control", "pydantic")
SOURCES = ("*.py", "*.json", "*.jinja", "*.css", "*.js")
SHIPPED = "shipped"
"""Name of folders of an installed package that a checkout has elsewhere; nothing computes with them."""


def computed_by() -> str:
    """Hash of the package's sources, of the libraries' versions, of Python and of the type of processor.

    Where another package plugs in, every installed version counts, and the sources of that package; of kinds
    that this process has registered, the sources of their modules.
    """
    counted = {entry.module.partition(".")[0] for entry in _entries()}
    return _computed_by(tuple(k for k in kinds_of_others() if k.__module__.partition(".")[0] not in counted))


@lru_cache(maxsize=8)
def _computed_by(kinds: tuple[type, ...]) -> str:
    words = [sys.version, sys.platform, processor(), sources()]
    words += [f"{name} {version_of(name)}" for name in LIBRARIES]
    words += [f"{kind.__module__} {kind.__qualname__} {_source_of(kind)}" for kind in kinds]
    return hashlib.sha256("\n".join(words).encode()).hexdigest()


def _source_of(kind: type) -> str:
    """Hash of the source files that a kind comes with; where it has none, what no other process has."""
    module, top = sys.modules.get(kind.__module__), sys.modules.get(kind.__module__.partition(".")[0])
    place = getattr(module, "__file__", None)
    if place is None or not Path(place).is_file():
        return uuid.uuid4().hex
    folders = getattr(top, "__path__", ())
    files = {Path(place), *(file for folder in folders for file in Path(folder).rglob("*.py"))}
    digest = hashlib.sha256()
    for file in sorted(files):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def computes_with() -> dict[str, str]:
    """Versions of all that two machines must have alike to give the same numbers, by name."""
    versions = {name: version_of(name) for name in NUMERICAL}
    own = {"hammerstein": version_of("hammerstein-control"), "sources of hammerstein": sources()[:12]}
    return {"python": platform.python_version(), **versions, **own}


@cache
def sources() -> str:
    """Hash of the package's sources and of what plugs in."""
    digest = hashlib.sha256("\n".join(_plugged_in()).encode())
    files = [path for kind in SOURCES for path in PACKAGE.rglob(kind)]
    for path in sorted(path for path in files if SHIPPED not in path.relative_to(PACKAGE).parts):
        digest.update(f"\n{path.relative_to(PACKAGE)}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def version_of(name: str) -> str:
    """Version of an installed package, or ``?``."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "?"


@cache
def processor() -> str:
    """Type of the processor: compiled loops and linear algebra choose their instructions by it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    kept = {
        line.partition(":")[0].strip(): line for line in lines if line.startswith(("model name", "flags"))
    }
    return " ".join([platform.machine(), *kept.values()])


@cache
def _entries() -> tuple[metadata.EntryPoint, ...]:
    """What other packages plug in."""
    found = entry_points(group="hammerstein.blocks")
    return tuple(entry for entry in found if not entry.value.startswith("hammerstein."))


def _plugged_in() -> Iterable[str]:
    """Installed versions, and sources of what plugs in; nothing where nothing does."""
    entries = _entries()
    if not entries:
        return
    yield from sorted(f"{found.name} {found.version}" for found in metadata.distributions())
    for top in sorted({entry.module.partition(".")[0] for entry in entries}):
        spec = find_spec(top)
        origin = Path(spec.origin) if spec is not None and spec.origin else None
        if origin is not None:
            files = origin.parent.rglob("*.py") if spec and spec.submodule_search_locations else [origin]
            yield from (f"{file} {hashlib.sha256(file.read_bytes()).hexdigest()}" for file in sorted(files))
