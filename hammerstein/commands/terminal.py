"""Output for any terminal: text, closed pipes, and progress."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hammerstein.errors import HammersteinError, tell_notices
from hammerstein.escaping import clean, one_line
from hammerstein.files import reason_of

if TYPE_CHECKING:
    from rich.table import Table

    from hammerstein.compensators.path_file import Onlooker, PathWork
    from hammerstein.experiment.set_up import Progress

WIDTH_OF_A_FILE = 160
"""Line width without terminal; the widest table fits."""
WARNINGS = ("FLAGGED", "Verdict: FLAGGED", "Warning:")
"""Beginnings of warning statements."""
_hushed = False


def hush(wanted: bool) -> None:
    """Switch to only mistakes, warnings and JSON, or back to all output."""
    global _hushed
    _hushed = wanted


class OutputError(HammersteinError):
    """Output cannot be written, for example because the disk is full."""

    exit_code = 2


def make_ready() -> None:
    """Print unsupported characters as question marks, and notices in one line."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    tell_notices()


def tell(text: str) -> None:
    """Print text; OutputError if it cannot be written."""
    if not _hushed:
        _print(clean(text))


def tell_statements(texts: Iterable[str]) -> None:
    """Print the statements of a result; warnings always go to stderr."""
    for text in texts:
        (complain if text.startswith(WARNINGS) else tell)(text)


def tell_json(content: Any, **options: Any) -> None:
    """Print JSON; OutputError if it cannot be written."""
    _print(clean(json.dumps(content, **options)))


@contextmanager
def _heard() -> Iterator[None]:
    """Print inside the block; OutputError if it cannot be written."""
    try:
        yield
    except OSError as error:
        nobody_listens(error)


def _print(text: str) -> None:
    with _heard():
        print(text, flush=True)


def complain(text: str) -> None:
    """Print on stderr; write errors are ignored."""
    with contextlib.suppress(OSError):
        print(clean(text), file=sys.stderr, flush=True)


def tell_kept(places: Iterable[Path]) -> None:
    """State the new names of files that a person had changed."""
    for place in places:
        complain(f"{place} is a result that you edited; a copy was kept")


def show(table: Table) -> None:
    """Print a table with the width of the terminal; in a file, wide enough for every column."""
    if _hushed:
        return
    from rich.console import Console

    if isinstance(table.title, str):
        table.title = one_line(table.title)
    for column in table.columns:
        shown = [column.header, *column._cells]
        column.header, *column._cells = [clean(cell) if isinstance(cell, str) else cell for cell in shown]
    plain = {"markup": False, "emoji": False, "highlight": False}
    console = Console(**plain)  # type: ignore[arg-type]
    with _heard():
        (console if console.is_terminal else Console(width=WIDTH_OF_A_FILE, **plain)).print(table)  # type: ignore[arg-type]
        sys.stdout.flush()


def settle() -> None:
    """Flush the output of libraries; OutputError if it cannot be written."""
    with contextlib.suppress(ValueError), _heard():  # where it is closed, there is nothing to flush
        sys.stdout.flush()


def nobody_listens(error: OSError) -> None:
    """Drop the remaining output after a reader, such as ``head``, has closed the pipe."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    if not isinstance(error, BrokenPipeError):
        raise OutputError(f"the output cannot be written ({reason_of(error)})") from None


class _Bar:
    """A bar on stderr until the block is left; None when nobody watches."""

    bar: Any = None

    def _start(self, *columns: Any) -> None:
        from rich.console import Console
        from rich.progress import Progress

        self.bar = Progress(*columns, console=Console(stderr=True), transient=True)
        self.bar.start()

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()


class Watch(_Bar):
    """Progress with the remaining time on stderr, for a terminal."""

    def __init__(self, scenarios: int):
        self.scenarios = scenarios

    def __enter__(self) -> Watch:
        if sys.stderr.isatty() and not _hushed:
            from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

            self._start(TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
            self.task = self.bar.add_task("running", total=self.scenarios)
            self.inner = self.bar.add_task("", total=1, visible=False)
        return self

    @property
    def progress(self) -> Progress | None:
        """Progress callback of a run; None without terminal."""
        return None if self.bar is None else self._within

    def _within(self, what: str, done: int, total: int) -> None:
        self.bar.update(self.inner, description=clean(what), completed=done, total=total, visible=True)

    def finished(self, name: str) -> None:
        """Count one more scenario."""
        if self.bar is not None:
            self.bar.update(self.task, advance=1, description=clean(name))
            self.bar.update(self.inner, visible=False)


EVERY_S = 60.0
"""Interval of progress lines in a file [s]."""


class Spinner(_Bar):
    """Progress on stderr: every step on a terminal, one line a minute in a file.

    first : first message, also in a file, for work that is always long
    """

    def __init__(self, first: str = ""):
        self.first = first
        self.told_s = time.monotonic()

    def __enter__(self) -> Spinner:
        if sys.stderr.isatty() and not _hushed:
            from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

            self._start(SpinnerColumn(), TimeElapsedColumn(), TextColumn("{task.description}", markup=False))
            self.task = self.bar.add_task(self.first or "reading", total=None)
        elif self.first and not _hushed:
            complain(self.first)
        return self

    def tell(self, what: str) -> None:
        """Show the current step."""
        if self.bar is not None:
            self.bar.update(self.task, description=clean(what))
        elif not _hushed and time.monotonic() - self.told_s >= EVERY_S:
            self.told_s = time.monotonic()
            complain(what)


TOLD_S = 2.0
"""Duration from which the cost of a path is stated before the work [s]."""


@contextmanager
def watched() -> Iterator[Onlooker]:
    """State samples, memory and time of a path before the work, and show progress."""
    from hammerstein.compensators.path_file import Onlooker

    with Spinner() as spinner:

        def begin(work: PathWork) -> None:
            if work.seconds > TOLD_S and not _hushed:
                complain(work.statement())

        yield Onlooker(begin, spinner.tell)
