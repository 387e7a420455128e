"""Figures of merit of a run and the mean cycle of a record: pure functions of arrays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
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
