"""Figures of merit of a run, their meanings, how each is found in the measured window, and rows of them.

To add one, write a function of a ``Measured`` and register it with ``metric``: its column, glossary, claims,
tolerances and baseline follow.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError, InputError
from hammerstein.quantities import interval


def settled_cycle(
    signal: ArrayLike, frequency_hz: float, sample_time_s: float, phases: int, *, skip_cycles: int = 0
) -> Array:
    """One mean cycle of a periodic record, also where the period is no whole number of samples.

    Every sample is put into the bin of its phase; signal and phase are averaged in each bin, and the mean
    cycle is read off at the bin centres.

    Parameters
    ----------
    signal : (axis, sample) a record that starts at phase 0
    frequency_hz : frequency of the cycle [Hz]
    sample_time_s : time between samples [s]
    phases : number of samples of the mean cycle
    skip_cycles : cycles at the start that have not settled; the first one never has if the actuator
        started from rest

    Returns
    -------
    (axis, phase) mean over the remaining whole cycles, from phase 0

    Raises
    ------
    IdentificationError : less than one whole cycle left, or fewer than two samples a cycle

    Examples
    --------
    At 150 Hz a cycle has 133.33 samples of 50 us:

    >>> u = np.sin(2.0 * np.pi * 150.0 * 50e-6 * np.arange(1200))
    >>> cycle = settled_cycle([u], 150.0, 50e-6, 400)
    >>> bool(np.allclose(cycle[0], np.sin(2.0 * np.pi * np.arange(400) / 400), atol=1e-12))
    True
    """
    values = np.atleast_2d(np.asarray(signal, dtype=np.float64))
    cycles_a_sample = frequency_hz * sample_time_s
    whole = int(np.floor(values.shape[1] * cycles_a_sample + 1e-9))
    if whole <= skip_cycles or not 0.0 < cycles_a_sample <= 0.5:
        raise IdentificationError(
            f"a record of {values.shape[1]} samples of {interval(sample_time_s)} holds {whole} whole cycles "
            f"at {frequency_hz:g} Hz; at least {skip_cycles + 1} cycles of two samples or more are "
            "needed"
        )
    first, stop = (int(np.ceil(c / cycles_a_sample - 1e-9)) for c in (skip_cycles, whole))
    position = phases * ((np.arange(first, stop) * cycles_a_sample) % 1.0)
    nearest = np.round(position).astype(np.int64)
    offset, bins = position - nearest, nearest % phases
    count = np.bincount(bins, minlength=phases)
    filled = np.flatnonzero(count)
    where = filled + np.bincount(bins, offset, phases)[filled] / count[filled]
    mean = [np.bincount(bins, row[first:stop], phases)[filled] / count[filled] for row in values]
    return np.array([np.interp(np.arange(phases), where, row, period=phases) for row in mean])


def rms(error: Array) -> float:
    """Root of the mean square over the last axis.

    >>> round(rms(np.array([3.0, -4.0])), 4)
    3.5355
    """
    return float(np.sqrt(np.mean(np.square(error))))


def worst(error: Array) -> float:
    """Largest absolute value."""
    return float(np.abs(error).max())


def euclidean(error: Array) -> Array:
    """Distance (sample,) between two paths, from the error (axis, sample)."""
    return np.asarray(np.linalg.norm(error, axis=0))


@dataclass(frozen=True)
class LoopFigures:
    """A settled loop: what the eye reads from it.

    height_um : from its lowest to its highest point (2 x amplitude)
    width_um : vertical opening at the middle of the input's range
    gain : first harmonic of the output over that of the input (um/V, or um/um for a reference)
    phase_deg : phase of the same ratio; negative for a lag
    """

    height_um: float
    width_um: float
    gain: float
    phase_deg: float

    @property
    def width_percent(self) -> float | None:
        """Width over height, h/H in the paper (section 5.2); None for a loop without height."""
        return 100.0 * self.width_um / self.height_um if self.height_um > 0.0 else None


def loop_figures(
    input_: Array,
    outputs_um: Array,
    frequency_hz: float,
    sample_time_s: float,
    skip_cycles: int,
    harmonics: int,
) -> list[LoopFigures]:
    """Figures of the mean settled loops of one input, one for each output.

    Parameters
    ----------
    input_ : (sample,) voltage [V] or reference [um] from phase 0
    outputs_um : (output, sample) positions or readings
    frequency_hz, sample_time_s : frequency of the cycle and time between samples
    skip_cycles : cycles that have not settled
    harmonics : harmonics kept of the mean cycle; above the sensor's bandwidth there is only noise
    """
    phases = 2 * max(2, round(0.5 / (frequency_hz * sample_time_s)))
    cycle = settled_cycle(
        np.vstack([input_, outputs_um]), frequency_hz, sample_time_s, phases, skip_cycles=skip_cycles
    )
    spectrum = np.fft.rfft(cycle, axis=1)
    ratios = spectrum[1:, 1] / spectrum[0, 1]
    spectrum[:, harmonics + 1 :] = 0.0
    smooth = np.fft.irfft(spectrum[1:], phases)
    return [
        LoopFigures(
            height_um=float(np.ptp(y)),
            width_um=_opening(cycle[0], y),
            gain=float(abs(ratio)),
            phase_deg=float(np.degrees(np.angle(ratio))),
        )
        for y, ratio in zip(smooth, ratios, strict=True)
    ]


def _opening(u: Array, y: Array) -> float:
    """Distance of the two branches at the middle of the input's range."""
    start = int(np.argmin(u))
    u, y = np.roll(u, -start), np.roll(y, -start)
    top = int(np.argmax(u))
    middle = 0.5 * (u[0] + u[top])
    rising = np.interp(middle, u[: top + 1], y[: top + 1])
    falling = np.interp(middle, np.append(u[top:], u[0])[::-1], np.append(y[top:], y[0])[::-1])
    return float(abs(falling - rising))


ERROR = "the error is reading minus reference, or reading minus a model's prediction"
RECOVERY_S = 0.01  # a cut voltage leaves a resonance ringing


@dataclass(frozen=True)
class PathErrors:
    """Errors of a path against its reference or prediction [um].

    rms, worst : (output,) root mean square and largest absolute error of each axis
    distance_rms, distance_worst : the same of the distance over all axes
    """

    rms: tuple[float, ...]
    worst: tuple[float, ...]
    distance_rms: float
    distance_worst: float

    @classmethod
    def of(cls, path: Array, target: Array) -> Self:
        """Errors of a path (output, sample) against a target (output, sample) [um]."""
        from hammerstein.metrics.error_sums_kernel import error_sums

        squares, largest = np.zeros(len(path) + 1), np.zeros(len(path) + 1)
        error_sums(_rows(path), _rows(target), squares, largest)
        *each, whole = np.sqrt(squares / path.shape[1]).tolist()
        *worst, farthest = np.sqrt(largest).tolist()
        return cls(tuple(each), tuple(worst), whole, farthest)


def _rows(wire: Array) -> tuple[Array, ...]:
    """Rows of a wire one by one: those of a part of it lie in one piece each, the part does not."""
    return tuple(np.ascontiguousarray(row) for row in wire)


@dataclass(frozen=True, eq=False)
class Measured:
    """Signals of one case over the measured samples, and their targets.

    reading_um, position_um : (output, sample) reading of the sensor, and true position [um]
    saturated : (input, sample) whether the drive's range clipped the voltage
    target_reading_um, target_position_um : (output, sample) target of reading and position: a reference, or
        the prediction of a model [um]; None without one
    reference_um : (output, sample) path [um], if all axes are driven together
    cycle_samples : samples of a cycle, where several equal ones of a whole number of samples are measured
    middle_um : (output,) middle of that path [um]; zero if not given
    loops : (output,) loops of the readings against the driven signal, if there is only one
    """

    sample_time_s: float
    reading_um: Array
    position_um: Array
    saturated: NDArray[np.bool_]
    target_reading_um: Array | None = None
    target_position_um: Array | None = None
    reference_um: Array | None = None
    cycle_samples: int | None = None
    loops: Sequence[LoopFigures] | None = None
    middle_um: Array | None = None

    @cached_property
    def errors(self) -> PathErrors | None:
        """How far the reading is from what it is compared with; None where there is nothing."""
        target = self.target_reading_um
        return None if target is None else PathErrors.of(self.reading_um, target)

    @cached_property
    def true_errors(self) -> PathErrors | None:
        """The same of the true position."""
        target = self.target_position_um
        return None if target is None else PathErrors.of(self.position_um, target)

    @cached_property
    def in_the_plane(self) -> tuple[float, float] | None:
        """Largest errors of the radius [um], of reading and position; None where a path has not two axes."""
        from hammerstein.metrics.error_sums_kernel import plane_errors

        if self.reference_um is None or len(self.reference_um) != 2:
            return None
        wires = (self.reference_um, self.reading_um, self.position_um)
        radial, true = plane_errors(*(row for wire in wires for row in _rows(wire)), self.middle)
        return float(radial), float(true)

    @property
    def middle(self) -> Array:
        """Middle (output,) of the path [um], from which radii are counted."""
        return np.zeros(len(self.reading_um)) if self.middle_um is None else self.middle_um


Values = Sequence[float | None] | float | None
"""One value for each output, or one for all of them; None where the figure has no meaning."""


@dataclass(frozen=True)
class Metric:
    """One figure of merit.

    name : its column, with the unit at its end
    meaning : explanation for a reader, with the unit
    of : its value for the measured window of a case
    ratio_of : name of the figure in the denominator; if that is zero, this figure is rounding error
    exact : whether it is a count, which has no tolerance
    drawn : whether an uncertain actuator gives a band of it
    asked_by : kind of assessment that alone needs it, such as one publication; empty: every run has it
    heading : heading of its column beside the distance and the radius of a path; empty: no column
    """

    name: str
    meaning: str
    of: Callable[[Measured], Values]
    ratio_of: str | None = None
    exact: bool = False
    drawn: bool = False
    asked_by: str = ""
    heading: str = ""

    def values(self, measured: Measured) -> list[float | None]:
        """One value for each output; None where the figure has no meaning."""
        found, outputs = self.of(measured), len(measured.reading_um)
        if found is None or isinstance(found, int | float):
            return [found] * outputs
        if len(found) != outputs:
            raise ValueError(f"metric {self.name} gives {len(found)} values for {outputs} outputs")
        return list(found)


METRICS: dict[str, Metric] = {}
"""Every figure by its name, in the order of the columns."""


def metrics_of(assessment: str = "") -> list[Metric]:
    """What a run with this kind of assessment measures."""
    return [metric for metric in METRICS.values() if metric.asked_by in ("", assessment)]


def metric(
    meaning: str,
    *,
    ratio_of: str | None = None,
    exact: bool = False,
    drawn: bool = False,
    asked_by: str = "",
    heading: str = "",
) -> Callable[[Callable[[Measured], Values]], Metric]:
    """Register a function of a ``Measured`` as the figure of merit of its name.

    Raises InputError where the name is taken.

    Examples
    --------
    >>> import numpy as np
    >>> @metric("smallest reading [um]")
    ... def lowest_um(measured):
    ...     return [float(row.min()) for row in measured.reading_um]
    >>> lowest_um.values(Measured(1.0, np.array([[2.0, 1.0]]), np.zeros((1, 2)), np.zeros((1, 2), bool)))
    [1.0]
    >>> del METRICS["lowest_um"]
    """

    def register(function: Callable[[Measured], Values]) -> Metric:
        name = function.__name__
        if name in METRICS:
            raise InputError(f"metric {name}", "this name is taken")
        METRICS[name] = Metric(name, meaning, function, ratio_of, exact, drawn, asked_by, heading)
        return METRICS[name]

    return register


def _add(name: str, meaning: str, errors: str, part: str, drawn: bool = False) -> None:
    """A part of the errors; there are none without a reference."""
    METRICS[name] = Metric(name, meaning, lambda m: getattr(getattr(m, errors), part, None), drawn=drawn)


for _of, _true, _read in (("errors", "", "sensor's reading"), ("true_errors", "_true", "true position")):
    _why = ", without the sensor" if _true else f"; {ERROR}"
    _add(f"rms{_true}_um", f"rms error of the {_read} [um]{_why}", _of, "rms", True)
    _add(f"max{_true}_um", f"largest absolute error of the {_read} [um]", _of, "worst", bool(_true))
for _of, _true, _read in (("errors", "", "reading"), ("true_errors", "_true", "true position")):
    _between = f"distance between {_read} and reference over all axes [um]"
    _add(f"euclidean_rms{_true}_um", f"rms {_between}", _of, "distance_rms")
    _add(f"euclidean_max{_true}_um", f"largest {_between}", _of, "distance_worst", bool(_true))


@metric(
    "largest distance between true position and reference, without the samples whose voltage is clipped "
    "and the 10 ms after each [um]"
)
def euclidean_max_unsaturated_um(m: Measured) -> Values:
    if m.true_errors is None or m.target_position_um is None:
        return None
    if not m.saturated.any():
        return m.true_errors.distance_worst
    cut, recovery = m.saturated.any(axis=0), np.ones(round(RECOVERY_S / m.sample_time_s) + 1)
    kept = np.convolve(cut, recovery)[: cut.size] < 0.5
    return worst(euclidean(m.position_um - m.target_position_um)[kept]) if kept.any() else None


@metric(
    "largest error of the radius of a path, from the reading [um]; the radius is the distance from "
    "the middle of the path"
)
def radial_max_um(m: Measured) -> Values:
    return None if m.in_the_plane is None else m.in_the_plane[0]


@metric("largest error of the radius of a path, for the true position [um]")
def radial_max_true_um(m: Measured) -> Values:
    return None if m.in_the_plane is None else m.in_the_plane[1]


@metric("mean error of the true position over the last cycle minus that over the first [um]")
def drift_true_um(m: Measured) -> Values:
    if m.target_position_um is None or m.cycle_samples is None:
        return None
    n = m.cycle_samples
    first, last = (m.position_um[:, part] - m.target_position_um[:, part] for part in np.s_[:n, -n:])
    return [float(value) for value in last.mean(axis=1) - first.mean(axis=1)]


def _loops(m: Measured, name: str) -> Values:
    return None if m.loops is None else [getattr(loop, name) for loop in m.loops]


_FIRST = "first harmonic of the reading divided by that of the driven quantity"
for _name, _ratio_of, _meaning in (
    (
        "height_um",
        None,
        "height of the loop from its lowest to its highest point, twice the amplitude; for a cross-coupling, "
        "its whole range [um]",
    ),
    ("width_um", None, "width of the loop at the middle of its input's range [um]"),
    ("width_percent", "height_um", "width divided by height [%]"),
    ("gain", None, f"{_FIRST} [um/V, or um/um for a reference]"),
    ("phase_deg", "gain", "phase of the same ratio; negative if the reading lags [deg]"),
):
    METRICS[_name] = Metric(_name, _meaning, partial(_loops, name=_name), ratio_of=_ratio_of)


@metric("number of samples in which the drive's range clipped the voltage", exact=True)
def saturated_samples(m: Measured) -> Values:
    return int(np.count_nonzero(m.saturated))


@dataclass(frozen=True)
class Keyed:
    """Key of a row, which identifies it among the others."""

    compensator: str
    excited_axis: str
    measured_axis: str
    frequency_hz: float
    amplitude_v: float | None = None
    amplitude_um: float | None = None
    trial: int | None = None

    def key(self) -> dict[str, Any]:
        """Return that by name."""
        return {name: getattr(self, name) for name in KEY}

    @property
    def place(self) -> tuple[Any, ...]:
        """The same without the names."""
        return tuple(self.key().values())

    @property
    def at(self) -> str:
        """Frequency in words, such as `` at 50 Hz``; nothing of a signal that has none."""
        return f" at {self.frequency_hz:g} Hz" if self.frequency_hz else ""


KEY = tuple(field.name for field in fields(Keyed))
"""Names of what tells one row from the others."""


@dataclass(frozen=True)
class Row(Keyed):
    """Figures of merit of one case on one measured axis; None if a figure is undefined.

    Errors are those of the sensor's reading, as in the paper; names with ``true`` are of the true position.
    A figure is read by its name: ``row.rms_um``.
    """

    figures: Mapping[str, float] = field(default_factory=dict)

    def __getattr__(self, name: str) -> float | None:
        if name not in METRICS:
            raise AttributeError(f"a row has no figure {name!r}")
        return self.figures.get(name)

    def not_finite(self) -> str:
        """Name of a figure that is infinite or NaN, empty if all are finite."""
        return next((name for name, value in self.figures.items() if not math.isfinite(value)), "")

    def columns(self) -> dict[str, Any]:
        """Everything in the row by name, None where a figure has no meaning."""
        names = (*(metric.name for metric in metrics_of()), *self.figures)
        return self.key() | {name: self.figures.get(name) for name in names}
