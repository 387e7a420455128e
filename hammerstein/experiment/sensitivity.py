"""Contribution of each uncertain parameter to the variance of a figure.

    first index  S_g = V[E(f | g)] / V[f],    total index  T_g = E[V(f | all but g)] / V[f]

S_g is the part of the variance that vanishes when g alone becomes known; T_g - S_g is the part of g together
with others. Errors of weights are correlated: those of one output are one group g, whitened by the factor of
their covariance. Saltelli et al., Computer Physics Communications 181 (2010) 259-270; estimators of SciPy.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.experiment.case_cache import CaseCache
from hammerstein.experiment.draws import NO_PART, Actuators, Figures, drawn_metrics, figures_on
from hammerstein.experiment.report import Sensitivity
from hammerstein.experiment.set_up import Case, Progress
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.scenario.uncertainty import Parameter, Uncertainty

RESAMPLED = 200  # times, for the confidence limits
LIMITS = (2.5, 97.5)  # percent
TINY = 1e-12  # probability; a normal number has no value for 0
LEAST_SPREAD = 1e-9  # standard deviation in parts of the mean; less is rounding and has no cause


def evaluations(samples: int, parameters: int) -> int:
    """Actuators that are run in every case: (d + 2) n."""
    return (parameters + 2) * samples


@dataclass(frozen=True, eq=False)
class _Exchanged(Actuators):
    """Actuators of one matrix of normal numbers (sample, number), of another, and of both mixed.

    All actuators meet the same noise, so that the parameters are the only cause.
    """

    parts: tuple[slice, ...]
    one: Array
    other: Array
    what = "finding sensitivities"

    @property
    def key(self) -> list[Any]:
        """How uncertain the actuator is, and how many samples there are."""
        return [self.uncertainty.model_dump_json(exclude=NO_PART), len(self.one)]

    @property
    def count(self) -> int:
        """All blocks of samples."""
        return evaluations(len(self.one), len(self.parts))

    def plant(self, number: int) -> Plant:
        """Give the actuator of a number: of a row of one matrix, or with the numbers of a group exchanged."""
        block, at = divmod(number, len(self.one))
        normal = (self.other if block == 1 else self.one)[at]
        if block >= 2:  # the first matrix, with the columns of one group from the other
            normal = normal.copy()
            normal[self.parts[block - 2]] = self.other[at, self.parts[block - 2]]
        return Plant(*self.uncertainty.of(self.nominal.model, self.nominal.instruments, normal))

    def seed(self, number: int) -> int:
        """Return the seed of its noise, the same for all."""
        return self.scenario_seed


def sensitivities_of(
    kept: CaseCache, cases: Sequence[Case], jobs: Jobs, progress: Progress | None
) -> tuple[Sensitivity, ...]:
    """Indices of every row and figure for every parameter; nothing where the scenario asks for none.

    Raises InputError where nothing is uncertain.
    """
    scenario, nominal = kept.setup.scenario, kept.setup.plant
    uncertainty = scenario.uncertainty
    if uncertainty is None or uncertainty.sensitivity is None:
        return ()
    groups = _groups(uncertainty, nominal.model)
    base = _base(uncertainty, sum(p.size for p in uncertainty.parameters(nominal.model)))
    parts = tuple(part for _, part in groups)
    actuators = _Exchanged(uncertainty, nominal, scenario.seed, parts, *base)
    found = figures_on(actuators, kept, cases, jobs, progress)
    names = [parameter.name for parameter, _ in groups]
    samples = uncertainty.sensitivity
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
        if _spreads(blocks[:2, :, r, m])
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


def _spreads(values: Array) -> bool:
    """Whether a figure is known everywhere and differs by more than its rounding."""
    return bool(np.isfinite(values).all() and values.std() > LEAST_SPREAD * abs(values.mean()))


def _saltelli(f: Array) -> tuple[Array, Array]:
    """First and total indices (figure, parameter) of values (figure, block, sample)."""
    from scipy.stats import sobol_indices

    values: dict[Any, Array] = {"f_A": f[:, 0], "f_B": f[:, 1], "f_AB": np.moveaxis(f[:, 2:], 1, 0)}
    found = sobol_indices(func=values, n=f.shape[2])
    shape = (len(f), f.shape[1] - 2)
    return np.reshape(found.first_order, shape), np.reshape(found.total_order, shape)
