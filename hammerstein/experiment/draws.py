"""A run repeated on many actuators: parallel batches, each stored, with memory for the figures alone."""

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.experiment.case_cache import CaseCache, rows_from
from hammerstein.experiment.measure import drawn_rows
from hammerstein.experiment.report import Band, Sensitivity
from hammerstein.experiment.set_up import Case, Experiment, SetUp
from hammerstein.metrics import Row, metrics_of
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant
from hammerstein.runtime.parallel_tasks import in_order, on_workers
from hammerstein.runtime.store import Kept
from hammerstein.scenario.variation import Parameter, Uncertainty

TOGETHER = 25  # actuators that are worked out, and kept, in one piece


@dataclass(frozen=True, eq=False)
class Actuators:
    """Many actuators near the nominal one, in a form for other processes.

    what : description for a person who watches
    key : everything that tells them from others, as plain JSON; how many there are does not count
    count : how many there are
    numbered : gives the actuator of a number, and the seed of its noise
    """

    what: str
    key: Any
    count: int
    numbered: Callable[[int], tuple[Plant, int]]


class Figures(NamedTuple):
    """Figures of one case on some actuators.

    rows : keys of the rows
    values : (actuator, row, metric) in the order of ``drawn_metrics``; NaN if a figure has no meaning
    """

    rows: tuple[Row, ...]
    values: Array


def drawn_metrics() -> list[str]:
    """Names of the figures that are computed on every actuator."""
    return [metric.name for metric in metrics_of() if metric.drawn]


def figures_on(actuators: Actuators, kept: CaseCache, cases: Sequence[Case]) -> list[Figures]:
    """Figures of every case on all actuators.

    The laws are those of the nominal actuator. Pieces run side by side; the numbers do not depend on that.
    """
    runs = [_Run(actuators, kept.setup, case) for case in cases]
    starts = range(0, actuators.count, TOGETHER)
    pieces = [range(first, min(first + TOGETHER, actuators.count)) for first in starts]
    found: dict[tuple[int, int], Figures] = {}  # by the numbers of piece and case
    left: dict[int, list[int]] = {}
    for number, i in np.ndindex(len(pieces), len(runs)):
        entry = kept.read(runs[i].case, "draws", runs[i].which(pieces[number]))
        if entry is None:
            left.setdefault(number, []).append(i)
        else:
            found[number, i] = Figures(rows_from(entry.document), entry.arrays["values"])
    open_ = list(left)

    def finished(done: int, figures: Sequence[Figures]) -> None:
        number = open_[done]
        for i, one in zip(left[number], figures, strict=True):
            found[number, i] = one
            entry = Kept([row.key() for row in one.rows], {"values": one.values})
            kept.write(entry, runs[i].case, "draws", runs[i].which(pieces[number]))
        if kept.progress:
            kept.progress(f"{actuators.what}{on_workers(kept.jobs)}", done + 1, len(open_))

    tasks = (partial(_over, [runs[i] for i in left[number]], pieces[number]) for number in open_)
    for _ in in_order(tasks, kept.jobs, finished):
        pass
    each = ([found[number, i] for number in range(len(pieces))] for i in range(len(runs)))
    return [Figures(same[0].rows, np.concatenate([part.values for part in same])) for same in each]


class _Run:
    """One case, to be done on many actuators: its voltages are worked out once, when they are needed."""

    def __init__(self, actuators: Actuators, setup: SetUp, case: Case) -> None:
        self.actuators, self.setup, self.case = actuators, setup, case
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return _Run, (self.actuators, self.setup, self.case)

    @cached_property
    def _experiment(self) -> Experiment:
        """What is done to an actuator."""
        return self.setup.experiment(self.case)

    def which(self, numbers: range) -> list[Any]:
        """Key of these actuators, as plain JSON."""
        return [self.actuators.key, numbers.start, numbers.stop]

    def over(self, actuators: Sequence[tuple[Plant, int]]) -> Figures:
        """Figures on these actuators, each with the seed of its noise."""
        with self._lock:
            names, experiment = drawn_metrics(), self._experiment
        drawn = [drawn_rows(self.setup, self.case, experiment(*actuator)) for actuator in actuators]
        values = [[[row.figures.get(name, np.nan) for name in names] for row in rows] for rows in drawn]
        return Figures(tuple(Row(**row.key()) for row in drawn[0]), np.array(values, dtype=np.float64))


def _over(runs: Sequence[_Run], numbers: range) -> list[Figures]:
    """Figures of some cases on some actuators, which are made once for all of them."""
    actuators = [runs[0].actuators.numbered(number) for number in numbers]
    return [run.over(actuators) for run in runs]


SEED_STEP = 7919  # keeps the noise of one draw apart from that of another scenario's seed
NO_PART = {"draws", "sensitivity"}
"""Keys of an uncertainty without effect on a draw."""


def _drawn(uncertainty: Uncertainty, nominal: Plant, seed: int, number: int) -> tuple[Plant, int]:
    """Draw of a number of an uncertain actuator; each has another noise."""
    drawn = Plant(*uncertainty.draw(nominal.model, nominal.instruments, number))
    return drawn, seed + SEED_STEP * (number + 1)


def bands_of(uncertainty: Uncertainty, kept: CaseCache, cases: Sequence[Case]) -> tuple[Band, ...]:
    """Median and 5-95 % band of every row over the draws."""
    numbered = partial(_drawn, uncertainty, kept.setup.plant, kept.setup.scenario.seed)
    key = uncertainty.model_dump_json(exclude=NO_PART)
    drawn = Actuators("drawing actuators", key, uncertainty.draws, numbered)
    found = figures_on(drawn, kept, cases)
    return tuple(band for figures in found for band in _bands(figures))


def _bands(figures: Figures) -> Iterator[Band]:
    """Bands of every row of one case."""
    for r, row in enumerate(figures.rows):
        for m, metric in enumerate(drawn_metrics()):
            values = figures.values[:, r, m]
            known = values[~np.isnan(values)]
            if len(known):
                low, middle, high = np.percentile(known, [5.0, 50.0, 95.0]).tolist()
                yield Band(metric=metric, p5_um=low, median_um=middle, p95_um=high, **row.key())


RESAMPLED = 200  # times, for the confidence limits
LIMITS = (2.5, 97.5)  # percent
TINY = 1e-12  # probability; a normal number has no value for 0
LEAST_SPREAD = 1e-9  # standard deviation in parts of the mean; less is rounding and has no cause


def evaluations(samples: int, parameters: int) -> int:
    """Number of actuators per case: (d + 2) n."""
    return (parameters + 2) * samples


def _exchanged(
    setting: tuple[Uncertainty, Plant, int], base: tuple[Array, Array], parts: Sequence[slice], number: int
) -> tuple[Plant, int]:
    """Actuator of a number: of a row (number,) of one matrix or the other, or with a group exchanged.

    All actuators meet the same noise, so that the parameters are the only cause.
    """
    (uncertainty, nominal, seed), (one, other) = setting, base
    block, at = divmod(number, len(one))
    normal = (other if block == 1 else one)[at]
    if block >= 2:  # the first matrix, with the columns of one group from the other
        normal = normal.copy()
        normal[parts[block - 2]] = other[at, parts[block - 2]]
    return Plant(*uncertainty.of(nominal.model, nominal.instruments, normal)), seed


def sensitivities_of(
    uncertainty: Uncertainty, kept: CaseCache, cases: Sequence[Case]
) -> tuple[Sensitivity, ...]:
    """Contribution of each uncertain parameter to the variance of every row and figure.

        first index  S_g = V[E(f | g)] / V[f],    total index  T_g = E[V(f | all but g)] / V[f]

    S_g is the part of the variance that vanishes when g alone becomes known; T_g - S_g is the part of g
    together with others. Errors of weights are correlated: those of one output are one group g, whitened by
    the factor of their covariance. Saltelli et al., Computer Physics Communications 181 (2010) 259-270;
    estimators of SciPy. Nothing where none is asked for.

    Raises InputError where nothing is uncertain.
    """
    if uncertainty.sensitivity is None:
        return ()
    scenario, nominal = kept.setup.scenario, kept.setup.plant
    groups = _groups(uncertainty, nominal.model)
    base = _base(uncertainty, sum(p.size for p in uncertainty.parameters(nominal.model)))
    parts = [part for _, part in groups]
    names, samples = [parameter.name for parameter, _ in groups], uncertainty.sensitivity
    key, count = [uncertainty.model_dump_json(exclude=NO_PART), samples], evaluations(samples, len(parts))
    exchanged = partial(_exchanged, (uncertainty, nominal, scenario.seed), base, parts)
    found = figures_on(Actuators("finding sensitivities", key, count, exchanged), kept, cases)
    return tuple(one for figures in found for one in _indices(figures, names, samples, uncertainty.seed))


def _groups(uncertainty: Uncertainty, model: HammersteinModel) -> list[tuple[Parameter, slice]]:
    """Parameters that vary, and where their normal numbers stand."""
    groups, start = [], 0
    for parameter in uncertainty.parameters(model):
        if parameter.varies:
            groups.append((parameter, slice(start, start + parameter.size)))
        start += parameter.size
    if not groups:
        raise InputError(
            "uncertainty.sensitivity",
            "nothing is uncertain; give weights, resonance, damping, creep or noise",
        )
    return groups


def _base(uncertainty: Uncertainty, size: int) -> tuple[Array, Array]:
    """Two independent sets (sample, number) of standard normal numbers, from one Sobol sequence."""
    from scipy.stats import norm, qmc

    assert uncertainty.sensitivity is not None
    sampler = qmc.Sobol(2 * size, scramble=True, rng=np.random.default_rng([uncertainty.seed, size]))
    normal = np.asarray(norm.ppf(np.clip(sampler.random(uncertainty.sensitivity), TINY, 1.0 - TINY)))
    return normal[:, :size], normal[:, size:]


def _indices(figures: Figures, names: Sequence[str], samples: int, seed: int) -> Iterator[Sensitivity]:
    """Indices of every figure of one case that spreads at all, with 95 % limits."""
    blocks = figures.values.reshape(len(names) + 2, samples, *figures.values.shape[1:])
    spread = [
        (r, m)
        for r in range(blocks.shape[2])
        for m in range(blocks.shape[3])
        if np.isfinite(own := blocks[:2, :, r, m]).all() and own.std() > LEAST_SPREAD * abs(own.mean())
    ]
    if not spread:
        return
    f = np.stack([blocks[:, :, r, m] for r, m in spread])  # (figure, block, sample)
    first, total = _saltelli(f)
    generator = np.random.default_rng(seed)
    again = [_saltelli(f[:, :, generator.integers(samples, size=samples)]) for _ in range(RESAMPLED)]
    limits = np.percentile(again, LIMITS, axis=0)  # (limit, first or total, figure, parameter)
    metrics = drawn_metrics()
    for i, (r, m) in enumerate(spread):
        for p, name in enumerate(names):
            low, high = limits[0, :, i, p].tolist(), limits[1, :, i, p].tolist()
            yield Sensitivity(
                metric=metrics[m],
                parameter=name,
                **figures.rows[r].key(),
                first=float(first[i, p]),
                first_low=low[0],
                first_high=high[0],
                total=float(total[i, p]),
                total_low=low[1],
                total_high=high[1],
            )


def _saltelli(f: Array) -> tuple[Array, Array]:
    """First and total indices (figure, parameter) of values (figure, block, sample)."""
    from scipy.stats import sobol_indices

    values: dict[Any, Array] = {"f_A": f[:, 0], "f_B": f[:, 1], "f_AB": np.moveaxis(f[:, 2:], 1, 0)}
    found = sobol_indices(func=values, n=f.shape[2])
    shape = (len(f), f.shape[1] - 2)
    return np.reshape(found.first_order, shape), np.reshape(found.total_order, shape)
