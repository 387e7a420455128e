"""Compile the time loops once after installation: those that one task needs, or all side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import wait
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hammerstein.actuators import DEFAULT
from hammerstein.arrays import Array
from hammerstein.compiled import CHECKED, told_before_compiling
from hammerstein.errors import HammersteinError
from hammerstein.model import HammersteinModel
from hammerstein.runtime.processes import FOR_LAWS, begin_loading
from hammerstein.runtime.processors import processors
from hammerstein.runtime.workers import Processes

if TYPE_CHECKING:
    from hammerstein.scenario import Scenario

TAKES = "about 15 s"
"""How long it takes, as README.md says, too."""
SAID = f"compiling time loops that are needed for the first time, up to {TAKES}"

RANGE_V, SAMPLE_TIME_S, SAMPLES = 10.0, 50e-6, 800


def compile_when_needed(say: Callable[[str], None]) -> None:
    """Tell a person, before the first loop is compiled; each is compiled when it is needed."""
    told_before_compiling(lambda: say(SAID))


def compile_all(say: Callable[[str], None]) -> None:
    """Compile every loop by using it, if none is kept yet: before several processes begin that need them."""
    if not _must_compile():
        return
    say(f"compiling the time loops, once after installation, {TAKES}")
    with Processes(2) as processes:
        wait([processes.submit(use) for use in USES])
    # what is not compiled here is compiled when it is used


@contextmanager
def compiled_beside(say: Callable[[str], None], scenario: Scenario, jobs: int) -> Iterator[None]:
    """Compile the loops of a scenario's laws in a process beside this one, which needs them late.

    It begins with the first loop that must be compiled, and ends with this block. A loop that both need is
    compiled by one of them.

    Parameters
    ----------
    say : tells a person, before the first loop is compiled
    scenario : what is about to be run
    jobs : how much may run side by side
    """
    from hammerstein.experiment.plan import jobs_that_fit, plans_of
    from hammerstein.hysteresis.play_kernels import respond_turning_points

    plans = plans_of({"here": scenario, "beside": scenario}).values()  # its signals are as long there
    fitting = jobs_that_fit(plans, min(jobs, processors()))
    helped = len(plans) == 2 and fitting > 1 and len(scenario.compensators) > 0
    if helped and not _is_cached(respond_turning_points):  # everything needs it
        begin_loading(FOR_LAWS)
    with ExitStack() as ends:

        def begin() -> None:
            say(SAID)
            if helped:
                processes = Processes(1, FOR_LAWS)
                ends.callback(processes.shutdown, cancel_futures=True)
                processes.submit(_use_laws, scenario)

        told_before_compiling(begin)
        ends.callback(told_before_compiling, None)
        yield


def _must_compile() -> bool:
    from hammerstein.compensators.exact.kernel import respond_exact
    from hammerstein.compensators.kernels import respond_inverse_multiplicative
    from hammerstein.hysteresis.play_kernels import respond_turning_points

    loops = (respond_turning_points, respond_inverse_multiplicative, respond_exact)
    return not all(_is_cached(loop) for loop in loops)


def _is_cached(loop: object) -> bool:
    """Whether an index file of this loop lies where numba keeps it."""
    place = loop.stats.cache_path  # type: ignore[attr-defined]  # numba's dispatcher has no types
    if place is None:  # nothing can be kept: each process compiles what it uses
        return True
    folder = Path(place)
    name = loop.__name__  # type: ignore[attr-defined]
    return any(folder.glob(f"*.{name}-*{CHECKED}.nbi"))


def _use_laws(scenario: Scenario) -> None:
    """Use the laws of a scenario once, each as if what is simulated were its model.

    The last one is the first here, and voltages come before positions: the run begins at the other end. What
    cannot be used here says why where it is run.
    """
    from hammerstein.experiment.measure import rows_of
    from hammerstein.experiment.set_up import SetUp, law_of, plant_of

    measure = scenario.measure.model_copy(update={"settle_cycles": 0, "settle_s": 0.0, "measured_cycles": 1})
    plant, used = plant_of(scenario), []
    for compensator in reversed(scenario.compensators):
        alone = scenario.model_copy(update={"measure": measure, "compensators": (compensator,)})
        with suppress(HammersteinError):
            law = law_of(compensator, plant.model, plant)
            setup = SetUp(alone, plant, {}, {compensator.label: law})
            for case in islice(setup.cases(), 1):
                setup.experiment(case)
                used.append((setup, case))
    for setup, case in used:
        with suppress(HammersteinError):
            rows_of(setup, case)


def _use_plays() -> None:
    """What an actuator is, and how it is identified."""
    from hammerstein.experiment.set_up import set_up
    from hammerstein.identification.identify import identify
    from hammerstein.identification.settings import Settings
    from hammerstein.identification.static.regressors import Start, regressor_blocks
    from hammerstein.records.record import Record

    setup = set_up(_scenario({"kind": "sine", "amplitude_um": 10.0}, "none"))
    responses = [setup.simulate(case) for case in setup.cases()]
    records = [Record(found.drive_v, found.reading_um, SAMPLE_TIME_S) for found in responses]
    identify(records, Settings(2, partition="time", dynamics="lag", creep_modes=0, error_curve=False))
    for _ in regressor_blocks(_path(), Start("rest"), [np.zeros(1)] * 2, with_derivatives=True):
        pass


def _use_inverse() -> None:
    from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw

    law = HammersteinInverseLaw(HammersteinModel.load(DEFAULT), RANGE_V, SAMPLE_TIME_S, filter_hz=2000.0)
    law.drive_for(_path())


def _use_other_laws() -> None:
    """Laws, and what is measured of a path."""
    _run("inverse_multiplicative", "decoupled_inverse")


def _use_feedback() -> None:
    _run("feedback")


USES = (_use_plays, _use_inverse, _use_other_laws, _use_feedback)
"""What takes longest to compile comes first; the later ones need the plays, which are there by then."""


def _run(*laws: str) -> None:
    from hammerstein.experiment.run import run

    run(_scenario({"kind": "circle", "radius_um": 10.0}, *laws))


def _scenario(reference: dict[str, Any], *laws: str) -> Scenario:
    """Laws on a simulated actuator."""
    from hammerstein.scenario import Scenario

    return Scenario.model_validate(
        {
            "question": "Does it run?",
            "actuator": DEFAULT,
            "reference": {"frequency_hz": 50.0} | reference,
            "compensators": [{"label": law, "law": law, "model": DEFAULT} for law in laws],
        }
    )


def _path() -> Array:
    time_s = SAMPLE_TIME_S * np.arange(SAMPLES)
    return 10.0 * np.vstack([np.sin(2.0 * np.pi * 50.0 * time_s), np.sin(2.0 * np.pi * 75.0 * time_s)])
