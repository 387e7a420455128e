"""Values that show a picture of themselves in a notebook."""

from __future__ import annotations

from importlib import import_module


class Pictured:
    """A value of which a notebook shows its short text and a picture."""

    def _repr_html_(self) -> str:
        # By name, for those that draw stand above what is drawn; a notebook knows only this method.
        return str(import_module("hammerstein.reporting.notebook").html_of(self))
