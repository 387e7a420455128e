"""How much memory there is: what is free on this machine, and what this process may have of it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from hammerstein.errors import SimulationError
from hammerstein.runtime.control_groups import groups, numbers

BYTES = 8
COPIES = 2
"""Peak of a run in parts of the wires that it keeps."""
SMALL_BYTES, SMALL_SHARE = 1e7, 0.01
"""What fits beside the libraries, or is so small a part of what was free at first: the system is not asked
again, for to read its files takes as long as a short run."""
UNLIMITED = 2**60
"""A limit from here on is none."""


def run_bytes(samples: float, inputs: int, outputs: int) -> float:
    """Bytes of the wires that one run keeps."""
    return samples * (BYTES * (2 * inputs + 4 * outputs) + inputs)


def refuse_too_long(samples: int, inputs: int, outputs: int) -> None:
    """Refuse a run whose wires do not fit the memory that is free.

    Parameters
    ----------
    samples : length of the run
    inputs, outputs : axes of the actuator

    Raises
    ------
    SimulationError : says how much is needed, and what to do
    """
    needed = COPIES * run_bytes(samples, inputs, outputs)
    if needed < SMALL_BYTES or needed < SMALL_SHARE * _free_at_first():
        return
    free = free_bytes()
    if needed > free:
        raise SimulationError(
            f"a run of {samples:.3g} samples needs about {needed / 1e9:.3g} GB of memory, and "
            f"{free / 1e9:.3g} GB are free. Measure fewer cycles, settle for a shorter time, use a longer "
            "instruments.drive.sample_time_s, or simulate it from Python with simulate_in_blocks."
        )


@cache
def _free_at_first() -> float:
    """Memory that was free when this process first asked."""
    return free_bytes()


def free_bytes() -> float:
    """Memory that this process may still take."""
    import psutil

    return min([float(psutil.virtual_memory().available), *_of_the_groups(), *_of_the_process()])


def _of_the_groups() -> Iterator[float]:
    """What the groups around this process leave of their limits."""
    for folder, second in groups("memory"):
        names = ("memory.max", "memory.current")
        if not second:
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
        limit, used = (numbers(folder / name) for name in names)
        if limit and used and limit[0] < UNLIMITED:
            yield max(limit[0] - used[0], 0.0)


def _of_the_process() -> Iterator[float]:
    """What a limit on the addresses of the process leaves, as ``ulimit -v`` sets it."""
    import psutil

    process = psutil.Process()
    if hasattr(process, "rlimit"):  # Linux; macOS holds nobody to it, and Windows has none
        limit = process.rlimit(psutil.RLIMIT_AS)[0]
        if limit != psutil.RLIM_INFINITY:
            yield max(0.0, float(limit - process.memory_info().vms))
