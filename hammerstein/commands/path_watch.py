"""What a person reads while a long path becomes voltages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hammerstein.commands.terminal import complain, hushed
from hammerstein.commands.watch import Spinner

if TYPE_CHECKING:
    from hammerstein.compensators.path_file import Onlooker, PathWork

TOLD_S = 2.0
"""Time from which the cost of a path is said before the work."""


@contextmanager
def watched() -> Iterator[Onlooker]:
    """Say samples, memory and time of a path before the work, and show what is being done."""
    from hammerstein.compensators.path_file import Onlooker

    with Spinner() as spinner:

        def begin(work: PathWork) -> None:
            if work.seconds > TOLD_S and not hushed():
                complain(work.statement())

        yield Onlooker(begin, spinner.tell)
