"""Drive that erases the history of hysteresis: decaying oscillation about the middle of the range."""

from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators.drive_file import Terms
from hammerstein.compensators.path_file import DRIVE_COST, PathWork, drive_csv
from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import interval
from hammerstein.signals import Degauss, smooth_step

MIN_POINTS = 20
"""Fewest samples of a period."""
LEAD_S = 0.1
"""Duration of the transition from the working point to the middle of the range [s]."""


@dataclass(frozen=True, eq=False)
class DegaussDrive:
    """Voltages that erase the history, and its predicted effect before and after them.

    drive_v : (m, N) absolute; before_um, after_um : (p,) difference of position between an actuator that was
        driven to the highest and one that was driven to the lowest voltage before
    """

    model: HammersteinModel
    limits: DriveRange
    signal: Degauss
    drive_v: Array
    before_um: Array
    after_um: Array

    def statements(self) -> list[str]:
        """Description of the drive and of the remaining effect of history."""
        middle, working = self.drive_v[:, -1], self.limits.working_point_v
        volts = ", ".join(f"{u:.6g} V on {n}" for n, u in zip(self.model.inputs, middle, strict=True))
        left = "; ".join(
            f"{name} {before:.3g} um before, {after:.3g} um after"
            for name, before, after in zip(self.model.outputs, self.before_um, self.after_um, strict=True)
        )
        said = [
            f"Degauss drive of model {self.model.origin}: {self.signal.cycles} falling periods at "
            f"{self.signal.frequency_hz:g} Hz about {volts}.",
            f"Position difference between histories from the two ends of the range: {left}.",
        ]
        if np.allclose(middle, working):
            said.append("Afterwards the model starts at rest, as compensate --at-rest assumes.")
        else:
            said.append(
                "It ends in the middle of the range, not at the working point of the model: record "
                "the actuator from there, so that the model also starts there."
            )
        return said

    def to_csv(self) -> str:
        """Text of the drive file."""
        step = self.model.instruments.drive.sample_time_s
        groups = (("drive", "v", self.model.inputs, self.drive_v),)
        return drive_csv(step * np.arange(self.drive_v.shape[1], dtype=np.float64), groups, self.statements())


def degauss_drive(
    model: HammersteinModel, frequency_hz: float, cycles: int, terms: Terms | None = None
) -> DegaussDrive:
    """Decaying oscillation of all inputs about the middle of the range, on the model's sample time.

    Parameters
    ----------
    model : m inputs
    frequency_hz : of the oscillation [Hz]; well below the resonance
    cycles : periods in which the amplitude falls to zero, after a first one
    terms : range, and whether it may exceed the records

    Raises
    ------
    InputError : a range without limits or other options that do not fit
    SimulationError : the samples do not fit the memory, or the drive leaves the records

    Examples
    --------
    >>> found = degauss_drive(HammersteinModel.load("duo_bimorph_static"), 10.0, 40)
    >>> bool((found.after_um < 0.05 * found.before_um).all()), found.drive_v[:, -1].tolist()
    (True, [0.0, 0.0])
    """
    terms = terms or Terms()
    limits = terms.allowed_range(model)
    if not np.isfinite(limits.span_v).all():
        raise InputError("--range", "has no ends for the alternation; give LOW,HIGH")
    step = model.instruments.drive.sample_time_s
    if frequency_hz > (most := 1.0 / (MIN_POINTS * step)):
        raise InputError("--frequency", f"must be at most {most:g} Hz on {interval(step)}")
    signal = Degauss(amplitude=1.0, frequency_hz=frequency_hz, cycles=cycles, axis="all")
    samples = int(np.ceil((signal.period_s + LEAD_S) / step)) + 1
    PathWork(samples, step, DRIVE_COST).refuse_too_large("degauss")
    m, middle = len(model.inputs), 0.5 * (limits.low_v + limits.high_v)
    time_s = step * np.arange(samples) - LEAD_S
    wave = signal.sample(np.maximum(time_s, 0.0), m) * (0.5 * limits.span_v[:, None])
    way = (limits.working_point_v - middle)[:, None] * (1.0 - smooth_step(np.asarray(time_s / LEAD_S + 1.0)))
    drive = middle[:, None] + wave + way
    terms.refuse_beyond(model, drive)
    ends = (limits.low_v, limits.high_v)
    before, after = (_spread(model, ends, sent) for sent in (middle[:, None], drive))
    return DegaussDrive(model, limits, signal, drive, before, after)


def _spread(model: HammersteinModel, ends: tuple[Array, Array], sent: Array) -> Array:
    """Difference (p,) of the last positions [um] after two histories, each one end of the range first."""
    here = model.on_grid(model.instruments.drive.sample_time_s)
    last = [here.static_response(np.hstack([end[:, None], sent]))[0][:, -1] for end in ends]
    return np.asarray(np.abs(last[1] - last[0]))
