"""How far a command is, for a person who watches."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from hammerstein.commands.terminal import complain, hushed
from hammerstein.escaping import clean

if TYPE_CHECKING:
    from hammerstein.compensators.path_file import Onlooker, PathWork
    from hammerstein.experiment.set_up import Progress


class Watch:
    """Progress with the remaining time on stderr, when a person watches."""

    def __init__(self, scenarios: int):
        self.scenarios = scenarios
        self.bar: Any = None

    def __enter__(self) -> Watch:
        if sys.stderr.isatty() and not hushed():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
            self.bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self.bar.start()
            self.task = self.bar.add_task("running", total=self.scenarios)
            self.inner = self.bar.add_task("", total=1, visible=False)
        return self

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()

    @property
    def progress(self) -> Progress | None:
        """What a run calls while it works; None when nobody watches."""
        return None if self.bar is None else self._within

    def _within(self, what: str, done: int, total: int) -> None:
        self.bar.update(self.inner, description=clean(what), completed=done, total=total, visible=True)

    def finished(self, name: str) -> None:
        """Count one more scenario."""
        if self.bar is not None:
            self.bar.update(self.task, advance=1, description=clean(name))
            self.bar.update(self.inner, visible=False)


EVERY_S = 60.0
"""How often a file is told what is being done."""


class Spinner:
    """Progress on stderr: every step when a person watches, one line a minute in a file.

    first : first message, also in a file, for work that is always long
    """

    def __init__(self, first: str = ""):
        self.first = first
        self.status: Any = None
        self.told_s = time.monotonic()

    def __enter__(self) -> Spinner:
        if sys.stderr.isatty() and not hushed():
            from rich.console import Console

            self.status = Console(stderr=True).status(self.first or "reading")
            self.status.start()
        elif self.first and not hushed():
            complain(self.first)
        return self

    def __exit__(self, *_: object) -> None:
        if self.status is not None:
            self.status.stop()

    def tell(self, what: str) -> None:
        """Show what is being done."""
        if self.status is not None:
            from rich.text import Text

            self.status.update(Text(clean(what)))
        elif not hushed() and time.monotonic() - self.told_s >= EVERY_S:
            self.told_s = time.monotonic()
            complain(what)


TOLD_S = 2.0
"""Time from which the cost of a path is said before the work."""


@contextmanager
def watched() -> Iterator[Onlooker]:
    """State samples, memory and time of a path before the work, and show progress."""
    from hammerstein.compensators.path_file import Onlooker

    with Spinner() as spinner:

        def begin(work: PathWork) -> None:
            if work.seconds > TOLD_S and not hushed():
                complain(work.statement())

        yield Onlooker(begin, spinner.tell)
