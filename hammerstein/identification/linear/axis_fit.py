"""Resonance, damping, lag and creep of each axis from records, with standard errors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import Axis
from hammerstein.identification.excitation import drive_hz, lowest_hz, several_rates
from hammerstein.identification.linear.axis_search import Point, fit_slopes, refine, residuals
from hammerstein.identification.linear.axis_task import AxisTask, axis_of
from hammerstein.identification.model_selection import FELT, IMPROVED, lowers
from hammerstein.identification.operators import input_grids
from hammerstein.identification.static.regressors import Filter, SideBySide
from hammerstein.records.record import Record

UNSURE_PERCENT = 5.0  # standard error of a resonance from which the records do not identify it
UNSURE_LAG_PERCENT = 30.0  # the same of a low-pass
APART = 2.0
"""Ratio of the time constants of two slow modes from which they are two."""
SURE_CREEP = 3.0
"""Significance, in standard errors, that the gain of a creep mode needs unless it is requested."""
CREEP_OPERATORS = 6  # few: creep is slower than any loop
FEW = 40
"""Columns with which a fit begins where more are kept: those of the largest power, which come last."""
PARTS = 16
"""Parts of a record within which residuals may be correlated."""
NEAR = 1.15
"""Ratio of frequencies that belong to a resonance."""
SETTLED_CYCLES = 4.0
"""Cycles of a record from which its spectrum has lines."""
EXCITED = 2.0
"""Amplitude near a resonance, relative to the residual there, from which it counts as excited."""


@dataclass(frozen=True)
class AxisFit:
    """One axis and the accuracy of its parameters.

    Parameters
    ----------
    axis : resonance, damping, lag, creep
    resonance_error_percent, damping_error_percent : standard errors, in percent of the value; None without a
        resonance
    creep_gain_errors : standard errors of the creep gains
    rms_um : rms of the prediction error [um]
    static_rms_um : the same without dynamics [um]
    lag_error_percent : standard error of the time constant, in percent of it; None without a lag
    excited : whether the records excite the resonance: near it, the model has more power than its error
    one_rate : whether hysteresis could have the same effect, because the records have one rate only: a lag
        widens the loops, and the resonance is among the first harmonics
    unsure : the same fit with slow modes, which were omitted because the records do not determine their gains
    """

    axis: Axis
    resonance_error_percent: float | None
    damping_error_percent: float | None
    creep_gain_errors: tuple[float, ...]
    rms_um: float
    static_rms_um: float
    lag_error_percent: float | None = None
    excited: bool = True
    one_rate: bool = False
    unsure: AxisFit | None = None

    @property
    def lowers_the_error(self) -> bool:
        """Whether the dynamics lower the error significantly.

        A resonance outside the excited band must lower it as much as any block that improves the model: below
        it, it only bends the response, as drift and creep do.
        """
        return lowers(self.rms_um, self.static_rms_um, FELT if self.excited else IMPROVED)

    @property
    def identified(self) -> bool:
        """Whether the records identify the dynamics.

        At a single rate, a lag and a resonance among the first harmonics may be hysteresis.
        """
        if self.one_rate or not self.lowers_the_error:
            return False
        known = self.resonance_error_percent is None or self.resonance_error_percent <= UNSURE_PERCENT
        return known and (self.lag_error_percent is None or self.lag_error_percent <= UNSURE_LAG_PERCENT)

    def creep_identified(self, records: Sequence[Record]) -> bool:
        """Whether the records identify the creep: slow modes of significant size that decay within a record.

        A mode that follows the drive within a radian of its fastest record cannot be separated from the gain,
        nor a mode slower than the longest record from drift. Two modes with nearly the same time constant
        count as one.
        """
        longest = max(record.sample_time_s * record.samples for record in records)
        shortest = 0.5 / np.pi / max(drive_hz(record) for record in records)
        times = sorted(mode.time_constant_s for mode in self.axis.creep)
        if any(slower < APART * faster for faster, slower in itertools.pairwise(times)):
            return False
        return all(
            shortest <= mode.time_constant_s <= longest and abs(mode.gain) >= SURE_CREEP * error
            for mode, error in zip(self.axis.creep, self.creep_gain_errors, strict=True)
        )

    def with_errors(self, errors: Array) -> AxisFit:
        """Return the same with the standard errors of ``axis.free`` (number,)."""
        known = iter((100.0 * errors).tolist())
        resonance, lag = self.axis.resonance_hz is not None, self.axis.lag_s is not None
        return replace(
            self,
            resonance_error_percent=next(known) if resonance else None,
            damping_error_percent=next(known) if resonance else None,
            lag_error_percent=next(known) if lag else None,
            creep_gain_errors=tuple(0.01 * gain for gain in list(known)[::2]),
        )


def fit_axis(task: AxisTask, begin: Array) -> AxisFit:
    """Fit one axis, starting from parameters near the best ones."""
    shape = task.shape
    static = fit_slopes(task, task.sensor_path)[1]
    if not shape.parameters:
        return AxisFit(Axis(), None, None, (), static, static)
    quick = _with_few_columns(task)
    point = refine(task, refine(quick, begin).x if quick else begin)
    found = AxisFit(
        axis=axis_of(shape, point.x),
        resonance_error_percent=None,
        damping_error_percent=None,
        creep_gain_errors=(),
        rms_um=point.rms,
        static_rms_um=static,
        excited=not shape.resonance or _excited(task, point),
        one_rate=_at_one_rate(task) and (shape.lag or (shape.resonance and _among_harmonics(task, point))),
    )
    return found.with_errors(standard_errors(task, point))


def _with_few_columns(task: AxisTask) -> AxisTask | None:
    """The same task for steps that cost less, where there may be many of them; None where it is small."""
    if task.kept:
        few = tuple(replace(one, values=one.values[-FEW:], held=one.held[-FEW:]) for one in task.kept)
        return replace(task, kept=few) if task.columns > FEW else None
    if not task.shape.creep_modes or task.columns <= len(task.grids):
        return None
    return replace(task, grids=tuple(input_grids(task.records, CREEP_OPERATORS, "voltage")))


def standard_errors(task: AxisTask, point: Point) -> Array:
    """Standard errors of the parameters, model error included.

    The larger of two estimates: for errors that are independent from sample to sample, and

        (H^-1 (sum over parts of g g^T) H^-1)_ii,    g = sum over the part of psi e

    with the derivatives psi of the output behind the slopes, and H = psi^T psi: errors may be correlated
    within a part (White, Econometrica 48 (1980) 817-838; Liang and Zeger, Biometrika 73 (1986) 13-22). The
    slopes are free; delay and thresholds are taken as known.
    """
    n = task.columns
    inverse = np.linalg.pinv(point.curvature, rcond=1e-14, hermitian=True)
    spread = np.zeros_like(inverse)
    path = partial(task.path, point.x)
    left = residuals(task, path, point.slopes)
    for i, (record, error) in enumerate(zip(task.records, left, strict=True)):
        time = record.sample_time_s
        filters: list[Filter] = [
            SideBySide(path(time)),
            task.derivatives(point.x, point.slopes, time),
        ]
        moves = np.hstack([x[n:] - point.drag.T @ x[:n] for _, x in task.blocks(i, filters)])
        moves -= moves.mean(axis=1, keepdims=True)
        ends = np.linspace(0, len(error), PARTS + 1).astype(int)
        scores = [moves[:, a:b] @ error[a:b] for a, b in itertools.pairwise(ends)]
        spread += np.sum([np.outer(g, g) for g in scores], axis=0)
    related = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))
    return np.asarray(np.maximum(related, point.errors))


def _excited(task: AxisTask, point: Point) -> bool:
    """Whether the model has more power near its resonance than it leaves there."""
    path = partial(task.path, point.x)
    hz = math.exp(point.x[0])
    said = left = 0.0
    for record, error in zip(task.records, residuals(task, path, point.slopes), strict=True):
        read = record.y_um[task.output, -len(error) :]
        # Differences leave nothing of slow motion to leak into the band, and keep ringing at the very start.
        spectra = [np.fft.rfft(np.diff(x)) for x in (read - error, error)]
        frequency_hz = np.fft.rfftfreq(len(error) - 1, record.sample_time_s)
        near = (frequency_hz > hz / NEAR) & (frequency_hz < hz * NEAR)
        said += float(np.sum(np.abs(spectra[0][near]) ** 2))
        left += float(np.sum(np.abs(spectra[1][near]) ** 2))
    return said > EXCITED**2 * left


def _at_one_rate(task: AxisTask) -> bool:
    """Whether all records are driven at one rate, and long enough for a spectrum of lines.

    A record of few cycles rings from its start.
    """
    cycles = [drive_hz(record) * record.samples * record.sample_time_s for record in task.records]
    return not several_rates(task.records) and max(cycles) >= SETTLED_CYCLES


def _among_harmonics(task: AxisTask, point: Point) -> bool:
    """Whether fewer than two multiples of the lowest frequency of the drive are near the resonance.

    One line of a spectrum is two numbers, as many as a resonance has: it explains any harmonic there.
    """
    width_hz = math.exp(point.x[0]) * (NEAR - 1.0 / NEAR)
    return width_hz < 2.0 * min(lowest_hz(record) for record in task.records)
