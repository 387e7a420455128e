"""Processors, memory and cache folder of this process, within the limits of a container.

Linux limits what a container may have by the groups of processes that it belongs to
(https://docs.kernel.org/admin-guide/cgroup-v2.html, and cgroup-v1 beside it).
"""

import ctypes
import math
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from hammerstein.errors import SimulationError

BYTES = 8  # of a double
COPIES = 2
"""Peak memory of a run, in parts of its stored signals."""
SMALL_BYTES, SMALL_SHARE = 1e7, 0.01
"""What fits beside the libraries, or is so small a part of what was free at first: the system is not asked
again, for to read its files takes as long as a short run."""
OWN_PAGES, KEPT_FREE = (-3, 2**25), (-1, 2**27)
"""Options M_MMAP_THRESHOLD and M_TRIM_THRESHOLD of glibc (``man mallopt``): bytes of an array that has pages
of its own, as many as glibc allows by itself, and bytes that stay free."""
UNLIMITED = 2**60
"""Limit from which there is none."""


def run_bytes(samples: float, inputs: int, outputs: int) -> float:
    """Memory of the signals of one run [bytes]."""
    return samples * (BYTES * (2 * inputs + 4 * outputs) + inputs)


def refuse_too_long(samples: int, inputs: int, outputs: int) -> None:
    """Refuse a run whose signals do not fit into the free memory.

    Parameters
    ----------
    samples : length of the run
    inputs, outputs : axes of the actuator

    Raises
    ------
    SimulationError : with the memory needed and the remedy
    """
    needed = COPIES * run_bytes(samples, inputs, outputs)
    if needed < SMALL_BYTES or needed < SMALL_SHARE * _free_at_first():
        return
    free = free_bytes()
    if needed > free:
        raise SimulationError(
            f"a run of {samples:.3g} samples needs about {needed / 1e9:.3g} GB of memory, "
            f"but {free / 1e9:.3g} GB are free. Measure fewer cycles, settle for a shorter "
            "time, use a longer instruments.drive.sample_time_s, or simulate it from Python with "
            "simulate_in_blocks."
        )


@cache
def _free_at_first() -> float:
    """Memory that was free when this process first asked."""
    return free_bytes()


def free_bytes() -> float:
    """Free memory of this process."""
    import psutil

    return min([float(psutil.virtual_memory().available), *_of_the_groups(), *_of_the_process()])


def _of_the_groups() -> Iterator[float]:
    """Memory that is free in the control groups of this process."""
    older = ("memory.limit_in_bytes", "memory.usage_in_bytes")
    for limit, used in _limits("memory", ("memory.max", "memory.current"), older):
        if limit < UNLIMITED:
            yield max(limit - used, 0.0)


def _of_the_process() -> Iterator[float]:
    """Memory that is free in the address space of this process, if it is limited (``ulimit -v``)."""
    import psutil

    process = psutil.Process()
    if hasattr(process, "rlimit"):  # Linux; macOS holds nobody to it, and Windows has none
        limit = process.rlimit(psutil.RLIMIT_AS)[0]
        if limit != psutil.RLIM_INFINITY:
            yield max(0.0, float(limit - process.memory_info().vms))


GROUPS = Path("/sys/fs/cgroup")
OWN_GROUP = Path("/proc/self/cgroup")


def groups(controller: str) -> Iterator[tuple[Path, bool]]:
    """Folders of the control groups of this process, its own first, and whether they are of version 2.

    controller : limited resource, such as ``memory``; without control groups, the result is empty
    """
    try:
        lines = OWN_GROUP.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        top = GROUPS / controller if controllers else GROUPS
        folder = top / path.lstrip("/")
        for place in (folder, *folder.parents):
            yield place, not controllers
            if place == top:
                break


def _limits(controller: str, second: Sequence[str], first: Sequence[str]) -> Iterator[tuple[float, float]]:
    """Limit and its measure in every group that has both: in files of version 2, or of version 1."""
    for folder, is_second in groups(controller):
        found = [one for name in (second if is_second else first) for one in numbers(folder / name)]
        if len(found) == 2:
            yield found[0], found[1]


def numbers(file: Path) -> list[float]:
    """Numbers in a file of the system; none for one that says "max" or is not there."""
    try:
        return [float(int(word)) for word in file.read_text().split()]
    except (OSError, ValueError):
        return []


def processors() -> int:
    """Number of processors for this process, at least one.

    What a container may have is rounded up: a job more than that slows nothing down, one less wastes time.
    """
    try:
        allowed = len(os.sched_getaffinity(0))
    except (AttributeError, OSError):  # macOS and Windows tell only how many there are
        allowed = os.cpu_count() or 1
    return max(1, min([allowed, *(math.ceil(share) for share in _shares())]))


def _shares() -> Iterator[float]:
    """Time of processors in each time, as far as groups around this process limit it."""
    for quota, period in _limits("cpu", ("cpu.max",), ("cpu.cfs_quota_us", "cpu.cfs_period_us")):
        if min(quota, period) > 0.0:  # without a limit the first one is -1
            yield quota / period


def cache_folder() -> Path | None:
    """The user's cache folder, or that of ``HAMMERSTEIN_CACHE``; None if nothing is cached."""
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
    """Folder of stored results; None if they are not stored."""
    place = cache_folder()
    return None if place is None else place / "kept"


def keep_freed_memory() -> None:
    """Keep freed memory for the next array, with glibc.

    Arrays of a few MB are made and freed thousands of times in a fit. Glibc gives them back to the system,
    which clears their pages for the next one: up to a third of the time of a fit.
    """
    with suppress(OSError, AttributeError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(*OWN_PAGES)
        mallopt(*KEPT_FREE)


_LOCK = threading.Lock()
_within: list[Any] = []
"""Callers inside the block; the first entry holds the previous setting, for the last one to restore."""


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit linear algebra to one thread inside the block, whatever the caller's settings; also a decorator.

    Sums of several threads differ in the last bits, and threads that wait for each other make small
    matrices several times slower. The command line sets one thread before NumPy is loaded. If several
    callers are inside at once, such as runs of a study, the last one restores the previous setting.
    """
    import scipy.linalg  # noqa: F401  # brings a library of its own: only what is loaded is limited
    from threadpoolctl import threadpool_limits

    with _LOCK:
        _within.append(_within[0] if _within else threadpool_limits(1, "blas"))
    try:
        yield
    finally:
        with _LOCK:
            limits = _within.pop()
            if not _within:
                limits.restore_original_limits()
