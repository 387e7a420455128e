"""Whether the cycles of a run had settled, and whether waiting longer would help."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.dynamics import AxesDynamics
from hammerstein.errors import HammersteinError
from hammerstein.experiment.set_up import Case, SetUp, Window
from hammerstein.model.simulation import Response
from hammerstein.signals import OneFrequency

SETTLED_FRACTION = 1e-3  # cycles may differ by this part of the range, beside the sensor's noise
LONGER = (2, 20)  # times the cycles before the measurement that are tried
END_SHARE = 0.1  # of a cycle: a law that looks further ahead sees the end of the path from the last one
MOST_SAMPLES = 4_000_000  # a longer run is not tried


def settled(setup: SetUp, case: Case, response: Response) -> bool:
    """Whether the first and the last measured cycle of the true position agree."""
    cycles = setup.scenario.measure.measured_cycles
    if not isinstance(case.signal, OneFrequency) or not case.signal.repeats or cycles < 2:
        return True
    first_sample = Window.of(setup.scenario, case.signal, response.sample_time_s).first
    position = response.position_um
    length = int(case.signal.period_s / response.sample_time_s)
    lag = round((cycles - 1) * case.signal.period_s / response.sample_time_s)
    first = position[:, first_sample : first_sample + length]
    last = position[:, first_sample + lag : first_sample + lag + length]
    fraction = abs(lag * response.sample_time_s / case.signal.period_s - (cycles - 1))
    allowed = (SETTLED_FRACTION + 2.0 * np.pi * fraction) * float(np.ptp(position))
    return float(np.abs(first[:, : last.shape[1]] - last).max()) <= allowed + 1e-9


def advice(setup: SetUp, case: Case) -> str:
    """What to do about a run that has not settled: how long to wait, or why waiting does not help.

    The run is done again with 2 and with 20 times as many cycles before the measurement.
    """
    cycles = max(1, Window.of(setup.scenario, case.signal, setup.plant.sample_time_s).settle_cycles)
    for factor in LONGER:
        measure = setup.scenario.measure.model_copy(update={"settle_cycles": factor * cycles})
        longer = replace(setup, scenario=setup.scenario.model_copy(update={"measure": measure}))
        if Window.of(longer.scenario, case.signal, setup.plant.sample_time_s).total > MOST_SAMPLES:
            return "whether waiting longer helps was not tried: the run is long"
        try:
            if settled(longer, case, longer.simulate(case)):
                return f"it does with measure.settle_cycles = {factor * cycles}"
        except HammersteinError:
            return "and it diverges if it goes on"
    return f"nor does it in {LONGER[-1]} times as many cycles: {_why(setup, case)}"


def _why(setup: SetUp, case: Case) -> str:
    law, dynamics = setup.laws.get(case.label), setup.plant.model.dynamics
    ahead_s = getattr(law, "preview_samples", 0) * setup.plant.sample_time_s
    if isinstance(law, InverseMultiplicativeLaw) and not law.convergence.converges:
        return "the iteration of its law does not converge"
    if isinstance(dynamics, AxesDynamics) and any(axis.creep for axis in dynamics.axes):
        slowest = max(mode.time_constant_s for axis in dynamics.axes for mode in axis.creep)
        return f"the actuator creeps, with time constants up to {slowest:g} s"
    if ahead_s > END_SHARE * case.signal.period_s:
        return f"its law looks {ahead_s:.3g} s ahead, and the last cycle responds to the end of the path"
    return "the cycles go on differing"
