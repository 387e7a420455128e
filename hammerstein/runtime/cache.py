"""Where results are kept: the user's cache folder."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def cache_folder() -> Path | None:
    """The user's cache folder, or the one that ``HAMMERSTEIN_CACHE`` names; None where nothing is kept."""
    named = os.environ.get("HAMMERSTEIN_CACHE")
    if named is not None:
        return Path(named) if named else None
    try:
        if sys.platform == "win32":
            return Path(os.environ.get("LOCALAPPDATA") or Path.home()) / "hammerstein"
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hammerstein"
    except RuntimeError:  # a user without a home
        return None


def folder_of_runs() -> Path | None:
    """Where results are kept; None if they are not."""
    place = cache_folder()
    return None if place is None else place / "kept"
