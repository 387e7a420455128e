"""Whether a run fits the memory of the machine, told before it begins."""

from __future__ import annotations

import os

from hammerstein.errors import SimulationError

BYTES = 8
COPIES = 3
"""Peak of a run in parts of the wires that it keeps."""


def refuse_too_long(samples: int, inputs: int, outputs: int) -> None:
    """Refuse a run whose wires do not fit the memory of this machine, where the system tells how much it has.

    Parameters
    ----------
    samples : length of the run
    inputs, outputs : axes of the actuator

    Raises
    ------
    SimulationError : says how much is needed, and what to do
    """
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return
    needed = COPIES * BYTES * samples * (2 * inputs + 4 * outputs)
    if needed > there:
        raise SimulationError(
            f"a run of {samples:.3g} samples needs about {needed / 1e9:.3g} GB of memory, this "
            f"machine has {there / 1e9:.3g}. Measure fewer cycles, settle for a shorter time, use a longer "
            "instruments.drive.sample_time_s, or simulate it from Python with simulate_in_stretches."
        )
