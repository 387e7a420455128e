"""Every figure of merit: name, unit, meaning, and how it is found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.errors import InputError
from hammerstein.metrics.arrays import LoopFigures, drift, worst
from hammerstein.metrics.measured_window import Measured

Values = Sequence[float | None] | float | None
"""One value for each output, or one for all of them; None where the figure has no meaning."""


@dataclass(frozen=True)
class Metric:
    """One figure of merit.

    name : its column, with the unit at its end
    meaning : what a reader must know of it, with the unit
    of : its value for the measured window of a case
    ratio_of : name of the figure that it is a ratio to: where that is zero, it is last bits over last bits
    exact : whether it is a count, which no tolerance lets move
    drawn : whether an uncertain actuator gives a band of it, where every run has it
    asked_by : kind of assessment that alone wants it, as of one publication; empty: every run has it
    heading : of its column beside the distance and the radius of a path; empty: it has none there
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


@metric(
    "root mean square of the error of the sensor's reading [um]; the error is reading minus "
    "reference, or reading minus a model's prediction",
    drawn=True,
)
def rms_um(m: Measured) -> Values:
    return None if m.errors is None else m.errors.rms


@metric("largest absolute error of the sensor's reading [um]")
def max_um(m: Measured) -> Values:
    return None if m.errors is None else m.errors.worst


@metric("root mean square of the error of the true position [um], without the sensor", drawn=True)
def rms_true_um(m: Measured) -> Values:
    return None if m.true_errors is None else m.true_errors.rms


@metric("largest absolute error of the true position [um]", drawn=True)
def max_true_um(m: Measured) -> Values:
    return None if m.true_errors is None else m.true_errors.worst


@metric("root mean square of the distance between reading and reference over all axes [um]")
def euclidean_rms_um(m: Measured) -> Values:
    return None if m.errors is None else m.errors.distance_rms


@metric("largest distance between reading and reference over all axes [um]")
def euclidean_max_um(m: Measured) -> Values:
    return None if m.errors is None else m.errors.distance_worst


@metric("root mean square of the distance between true position and reference over all axes [um]")
def euclidean_rms_true_um(m: Measured) -> Values:
    return None if m.true_errors is None else m.true_errors.distance_rms


@metric("largest distance between true position and reference over all axes [um]", drawn=True)
def euclidean_max_true_um(m: Measured) -> Values:
    return None if m.true_errors is None else m.true_errors.distance_worst


@metric(
    "largest distance between true position and reference, without the samples whose voltage is cut "
    "and the 10 ms after each [um]"
)
def euclidean_max_unsaturated_um(m: Measured) -> Values:
    if m.true_errors is None or not m.saturated.any():
        return None if m.true_errors is None else m.true_errors.distance_worst
    if m.true_distance_um is None or not m.unsaturated.any():
        return None
    return worst(m.true_distance_um[m.unsaturated])


@metric(
    "largest error of the radius of a path, from the reading [um]; the radius is the distance from "
    "the middle of the path"
)
def radial_max_um(m: Measured) -> Values:
    return None if m.in_the_plane is None else m.in_the_plane.radial


@metric("largest error of the radius of a path, for the true position [um]")
def radial_max_true_um(m: Measured) -> Values:
    return None if m.in_the_plane is None else m.in_the_plane.radial_true


@metric("mean error of the true position over the last cycle minus that over the first [um]")
def drift_true_um(m: Measured) -> Values:
    if m.target_position_um is None or m.cycle_samples is None:
        return None
    n = m.cycle_samples
    ends = [m.position_um[:, part] - m.target_position_um[:, part] for part in (slice(n), slice(-n, None))]
    return [float(value) for value in drift(np.concatenate(ends, axis=1), n)]


@metric(
    "height of the loop from its lowest to its highest point, twice the amplitude; for a "
    "cross-coupling, its whole range [um]"
)
def height_um(m: Measured) -> Values:
    return _loops(m, lambda loop: loop.height_um)


@metric("width of the loop at the middle of its input's range [um]")
def width_um(m: Measured) -> Values:
    return _loops(m, lambda loop: loop.width_um)


@metric("width divided by height [%]", ratio_of="height_um")
def width_percent(m: Measured) -> Values:
    return _loops(m, lambda loop: loop.width_percent)


@metric(
    "first harmonic of the reading divided by that of the driven quantity [um/V, or um/um for a reference]"
)
def gain(m: Measured) -> Values:
    return _loops(m, lambda loop: loop.gain)


@metric("phase of the same ratio; negative if the reading lags [deg]", ratio_of="gain")
def phase_deg(m: Measured) -> Values:
    return _loops(m, lambda loop: loop.phase_deg)


@metric("number of samples in which the drive's range cut the voltage", exact=True)
def saturated_samples(m: Measured) -> Values:
    return int(np.count_nonzero(m.saturated))


def _loops(m: Measured, of: Callable[[LoopFigures], float | None]) -> Values:
    return None if m.loops is None else [of(loop) for loop in m.loops]
