"""Unexpected errors: one line, a separate exit code, and a file for a bug report."""

import hashlib
import platform
import sys
import tempfile
import traceback
from importlib import metadata
from pathlib import Path

from hammerstein.errors import HammersteinError, InputError, InternalError, SimulationError

DISTRIBUTION = "hammerstein-control"
LIBRARIES = ("control", "numba", "numpy", "pandas", "pydantic", "scipy", "typer")


def as_error(error: Exception) -> HammersteinError:
    """Error message for any exception.

    An error of the system (a file, memory) has its own message. Any other error is a fault of this program,
    and its details go to a file.
    """
    if isinstance(error, HammersteinError):
        return error
    if isinstance(error, OSError):
        reason = (error.strerror or str(error)).lower()
        return InputError(str(error.filename or "file"), f"cannot be used ({reason})")
    if isinstance(error, MemoryError):
        return SimulationError("out of memory; use fewer cases, shorter runs, or --jobs 1")
    file = _write_details(error)
    sent = f"please send in {file}" if file else "it could not be written to a file"
    what = str(error).partition("\n")[0][:200]
    return InternalError(f"internal error, a fault of this program ({type(error).__name__}: {what}); {sent}")


def _write_details(error: Exception) -> Path | None:
    """File with what is needed to find the fault; nothing where none can be written."""
    lines = "".join(traceback.format_exception(error))
    versions = ", ".join(f"{name} {version_of(name)}" for name in (DISTRIBUTION, *LIBRARIES))
    text = f"{versions}\nPython {sys.version}\n{platform.platform()}\n{sys.argv}\n\n{lines}"
    digest = hashlib.sha256(lines.encode(errors="replace")).hexdigest()[:8]
    path = Path(tempfile.gettempdir()) / f"hammerstein_fault_{digest}.txt"
    try:
        path.write_text(text, encoding="utf-8", errors="replace")
    except OSError:
        return None
    return path


def version_of(name: str) -> str:
    """Version of an installed package, or ``?``."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "?"
