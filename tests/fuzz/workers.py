"""Cases in a process of their own: one that dies, hangs or grows is a finding, and the next goes on."""

from __future__ import annotations

import multiprocessing
import os
import resource
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import psutil

from . import campaign

SLOW_S = 60.0
"""Processor time of one case; the wall clock of a loaded machine tells nothing."""
STUCK_S = 600.0
LARGE_KB = 2_000_000
GROWN = 3

Told = Callable[[str, int | None, str, float], None]
"""Called with a kind of case, its exit code or None, what was found, and its processor time [s]."""


def in_a_process(kind: str, cases: Callable[[Callable[[Callable[[], int]], None]], None], told: Told) -> bool:
    """Do cases in a forked process; False where it ended before the last one.

    Parameters
    ----------
    kind : name of the kind of case
    cases : called in the process with what does one case
    told : hears of every case, in this process
    """
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(cases, theirs))
    process.start()
    theirs.close()
    try:
        return _listen(kind, process, ours, told)
    finally:
        process.kill()
        process.join()
        ours.close()


def _listen(kind: str, process: Any, ours: Connection, told: Told) -> bool:
    known = psutil.Process(process.pid)
    busy, begun = _processor_s(known), time.monotonic()
    while True:
        try:
            heard = ours.recv() if ours.poll(1.0) else None
        except EOFError:
            process.join()
            told(kind, None, f"the process ended with {process.exitcode}", 0.0)
            return False
        if heard == "done":
            return True
        if heard is not None:
            told(kind, *heard)
            ours.send("go on")  # the files of the case were wanted
            busy, begun = _processor_s(known), time.monotonic()
        elif _processor_s(known) - busy > SLOW_S or (time.monotonic() - begun > STUCK_S and _waits(known)):
            seconds = _processor_s(known) - busy
            told(kind, None, f"slow: not done after {seconds:.0f} s of the processor", seconds)
            return False


def _processor_s(process: psutil.Process) -> float:
    try:
        times = process.cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return float(times.user + times.system)


def _waits(process: psutil.Process) -> bool:
    """Whether a process asks for no processor; on a loaded machine one that does may not get it."""
    try:
        return process.status() != psutil.STATUS_RUNNING
    except psutil.NoSuchProcess:
        return True


def _work(cases: Callable[[Callable[[Callable[[], int]], None]], None], theirs: Connection) -> None:
    import typer

    from hammerstein.commands import cli

    app = typer.main.get_command(cli.built())  # made once: a command line makes it for each call
    cli.built = lambda words: app

    def one(work: Callable[[], int]) -> None:
        begun = time.process_time()
        code, found = campaign.watched(work)
        _tell(theirs, code, found, time.process_time() - begun)
        if (peak := resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) > LARGE_KB:
            _tell(theirs, None, f"large: {peak / 1e6:.1f} GB resident", 0.0)
            os._exit(GROWN)

    cases(one)
    theirs.send("done")


def _tell(theirs: Connection, code: int | None, found: str, seconds: float) -> None:
    theirs.send((code, found, seconds))
    theirs.recv()
