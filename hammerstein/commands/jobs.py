"""Workers of a command: threads and processes of this machine, or a cluster."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Annotated

import typer

from hammerstein.commands.terminal import complain
from hammerstein.errors import InputError
from hammerstein.runtime.resources import processors

if TYPE_CHECKING:
    from hammerstein.runtime import parallel_tasks

Address = Annotated[
    str | None,
    typer.Option("--cluster", metavar="ADDRESS", help="Run on this Dask scheduler, tcp://HOST:PORT."),
]

Jobs = Annotated[int, typer.Option(min=1, help="Parallel runs.", show_default="one for each processor")]
PROCESSORS = processors()
Yes = Annotated[bool, typer.Option("--yes", help="Start runs of more than ten minutes, too.")]

WORTH_PROCESSES_S = 4.0
"""Planned time of many short runs from which processes are worthwhile."""


@contextmanager
def workers(jobs: int, cluster: str | None) -> Iterator[parallel_tasks.Jobs]:
    """Return the workers of a cluster, if there is one, or the jobs of this machine.

    Raises InputError where the cluster cannot be used.
    """
    if cluster is None:
        yield jobs
        return
    from hammerstein.runtime.cluster import joined

    with joined(cluster) as crew:
        complain(f"using {crew.workers} workers of {cluster}")
        yield crew


def process_pool(jobs: parallel_tasks.Jobs, seconds: float) -> AbstractContextManager[parallel_tasks.Jobs]:
    """Return processes for many short runs with this planned total time on one processor.

    Threads of one process share Python's interpreter, but begin at once.
    """
    from hammerstein.runtime.parallel_tasks import ProcessesAndThis

    if isinstance(jobs, int) and jobs > 1 and seconds > WORTH_PROCESSES_S:
        return ProcessesAndThis(jobs)
    return nullcontext(jobs)


def announce(text: str, seconds: float, yes: bool) -> None:
    """Announce work that takes long.

    Parameters
    ----------
    text : description of the work
    seconds : expected time
    yes : whether a person has agreed beforehand

    Raises InputError if it takes more than ten minutes, a person watches, and has not agreed.
    """
    from hammerstein.experiment.plan import LONG_S, TOLD_S

    if seconds <= TOLD_S:
        return
    if seconds > LONG_S and not yes and sys.stdin.isatty() and sys.stderr.isatty():
        raise InputError("plan", f"{text}. Or start it anyway with --yes")
    complain(text)
