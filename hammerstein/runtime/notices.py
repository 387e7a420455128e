"""Notices: messages that are no errors."""

from __future__ import annotations

import contextlib
import sys
import warnings
from typing import Any

from hammerstein.errors import Notice
from hammerstein.escaping import clean


def tell_notices() -> None:
    """Let notices of this process be one line on stderr, each time that there is one.

    What libraries warn of is for programmers: it is shown where ``-W`` or ``PYTHONWARNINGS`` ask for it.
    """
    others = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if not issubclass(category, Notice):
            if sys.warnoptions:
                others(message, category, *place, **more)
            return
        with contextlib.suppress(OSError):
            print(clean(str(message)), file=sys.stderr, flush=True)

    warnings.showwarning = show
    warnings.simplefilter("always", Notice)
