"""How many processors this process may use: a scheduler or a container may give it fewer than there are."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator

from hammerstein.runtime.control_groups import groups, numbers


def processors() -> int:
    """How many there are for this process, one at least.

    What a container may have is rounded up: a job more than that slows nothing down, one less wastes time.
    """
    try:
        allowed = len(os.sched_getaffinity(0))
    except (AttributeError, OSError):  # macOS and Windows tell only how many there are
        allowed = os.cpu_count() or 1
    return max(1, min([allowed, *(math.ceil(share) for share in _shares())]))


def _shares() -> Iterator[float]:
    """Time of processors in each time, as far as groups around this process limit it."""
    for folder, second in groups("cpu"):
        if second:
            limit = numbers(folder / "cpu.max")
        else:
            limit = [*numbers(folder / "cpu.cfs_quota_us"), *numbers(folder / "cpu.cfs_period_us")]
        if len(limit) == 2 and min(limit) > 0.0:  # without a limit the first one is -1
            yield limit[0] / limit[1]
