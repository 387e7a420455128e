"""Iterative learning: the next drive of a periodic path from the last one and its readings, and the law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from hammerstein.arrays import Array, Complex
from hammerstein.blocks import Law, Learner
from hammerstein.blocks.driving import RangeLike
from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.compensators.cycle import Cycle, Design, Player, centred, design_of
from hammerstein.compensators.drive_file import Terms
from hammerstein.compensators.path_file import CYCLE_COST, UNWATCHED, Onlooker, read_path
from hammerstein.dynamics import AxesDynamics, LinearBlock, discretise, linearised
from hammerstein.errors import InputError, SimulationError, naming
from hammerstein.metrics import rms
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Deviation, Frequency, Trial, column, interval, number_of
from hammerstein.signals.signal_files import read_signal

DEVIATIONS = 2.0  # standard deviations that are counted on
SURE = 0.5  # relative error up to which all of an error is learnt
FAINT = 10.0  # how many times weaker than at rest a model is no longer believed
WEIGHTS, RESONANCE = 0.05, 0.01
"""Relative errors of weights and resonances if the model file states none."""


@dataclass(frozen=True)
class ModelUncertainty:
    """Relative standard deviations of the weights and of the resonances of a model.

    Learning through the inverse of a model is ``e+ = (1 - Q T) e`` at each frequency, with T the response of
    inverse and actuator, and Q a filter. Where ``|T - 1| <= delta < 1`` it converges for every Q
    from 0 to 1, by ``1 - Q (1 - delta)`` a trial at worst. So Q is 1 up to delta = 1/2 and falls to 0 at
    delta = 1.

    Source: Bristow, Tharayil and Alleyne, A survey of iterative learning control, IEEE Control Systems
    Magazine 26 (2006) 96-114.
    """

    weights: float = WEIGHTS
    resonance: float = RESONANCE

    def relative(self, model: HammersteinModel, frequency_hz: Array, sample_time_s: float) -> Array:
        """Bound delta (frequency, output) of the relative error of the model, two standard deviations.

        Infinite where the response of the actuator is less than a tenth of its static gain:
        there it is another one, and its inverse would ask for more than a drive has.
        """
        ends = model.about_middle.amplitude(model.amplitude_v).sum(axis=1)
        block = linearised(model.dynamics, sample_time_s, ends)
        response, still = _diagonal(block, frequency_hz), np.abs(_diagonal(block, np.zeros(1)))
        faint = np.abs(response) * FAINT < still
        delta = np.where(faint, np.inf, DEVIATIONS * self.weights)
        if not isinstance(model.dynamics, AxesDynamics) or self.resonance == 0.0:
            return delta
        worst = np.zeros(delta.shape)
        for factor in (1.0 - DEVIATIONS * self.resonance, 1.0 + DEVIATIONS * self.resonance):
            moved = self._gains(model.dynamics, frequency_hz, sample_time_s, factor)
            worst = np.maximum(worst, np.abs(moved / response - 1.0))
        return np.asarray(delta + worst)

    @staticmethod
    def _gains(dynamics: AxesDynamics, frequency_hz: Array, sample_time_s: float, factor: float) -> Complex:
        """Response (frequency, output) of every axis with its resonance multiplied by a factor."""
        resonances = [axis.resonance_hz and factor * axis.resonance_hz for axis in dynamics.axes]
        each = zip(dynamics.axes, resonances, strict=True)
        axes = tuple(axis.model_copy(update={"resonance_hz": hz}) for axis, hz in each)
        return _diagonal(discretise(dynamics.model_copy(update={"axes": axes}), sample_time_s), frequency_hz)

    @staticmethod
    def share(delta: Array) -> Array:
        """Part Q of an error that is learnt with this uncertainty of the model."""
        return np.asarray(np.clip((1.0 - delta) / (1.0 - SURE), 0.0, 1.0))


def _diagonal(block: LinearBlock, frequency_hz: Array) -> Complex:
    """Response (frequency, output) of each output to its own input."""
    return np.asarray(np.diagonal(block.response(frequency_hz), axis1=1, axis2=2))


OTHER = 0.5
"""Error, in parts of the motion, from which a reading has another path, unit or time."""
SIGNIFICANT = 3.0  # standard deviations of normal noise: what an error must exceed to be learnt
RANDOM = 0.01  # how often white noise is taken for drift, per output: at any of the lines above 0 Hz
RANDOM_OFFSET = 0.2  # the same at 0 Hz, where sensors drift: a mistake delays this line by one trial
RANDOM_EXCESS = 0.8  # the same where 0 Hz has more than the white noise of all lines: most likely drift
SETTLING = 0.25  # of the length of a reading: time since the sensor read zero, in which it drifts too
LEAST_PERIODS = 3  # scatter between periods is known from two differences on
MEASURED = "measured"  # what the readings of a trial are called in messages, as long as they are no file


@dataclass(frozen=True, eq=False)
class IlcUpdate:
    """Update of a drive from one trial.

    drive_v : (m, N) next period of voltages; that of the trial if there is nothing left to learn
    error_um : (p, N) mean error of the trial, corrected for the sensor's lag
    noise_um : rms of the non-periodic part of the mean of the readings
    lifted : factor by which the correction for the sensor's lag amplifies this noise
    doubt_um2 : three-sigma bound of the mean square error that this noise causes
    learnt : corrected lines of the spectrum
    unsure : lines with an error beyond the noise that are not corrected, because the model is too uncertain
    slowest : largest part of an error that remains after a trial
    limit_hz : frequency from which the model is too uncertain to learn; inf if there is none
    before : result of the trial before, if given
    """

    drive_v: Array
    error_um: Array
    noise_um: float
    lifted: float
    doubt_um2: float
    learnt: int
    unsure: int
    slowest: float
    limit_hz: float
    before: IlcUpdate | None = None

    @property
    def square_um2(self) -> float:
        """Mean square of the mean error minus that of its noise; may be negative without error."""
        return rms(self.error_um) ** 2 - (self.lifted * self.noise_um) ** 2

    @property
    def error_rms_um(self) -> float:
        """Rms of the mean error without its noise."""
        return float(np.sqrt(max(self.square_um2, 0.0)))

    @property
    def finished(self) -> bool:
        """Whether learning ends: only noise remains, or the model is too uncertain for the rest."""
        return self.learnt == 0 or self.worse

    @property
    def worse(self) -> bool:
        """Whether this trial is worse than the one before, beyond the noise."""
        return self.before is not None and self.worse_than(self.before)

    def after(self, before: IlcUpdate, drive_v: Array) -> IlcUpdate:
        """Compare with the trial before, and keep its drive (m, N) if this trial is worse."""
        return replace(self, before=before, drive_v=drive_v if self.worse_than(before) else self.drive_v)

    def worse_than(self, before: IlcUpdate) -> bool:
        """Whether the error of this trial exceeds that of an earlier one by more than the noise of both."""
        return self.square_um2 > before.square_um2 + float(np.hypot(self.doubt_um2, before.doubt_um2))

    @property
    def size(self) -> str:
        """Rms error in words: a bound where it does not exceed the noise."""
        if self.square_um2 > self.doubt_um2:
            return f"{self.error_rms_um:.3g} um"
        return f"below {np.sqrt(self.error_rms_um**2 + self.doubt_um2):.2g} um"

    def statement(self) -> str:
        """Error of the trial, and whether to continue."""
        found = f"Rms error of this trial {self.size}, noise of the mean reading {self.noise_um:.2g} um."
        if self.before is not None:
            better = self.before.worse_than(self)
            found += f" The previous trial: {self.before.size} rms; this trial is "
            found += "better." if better else "worse." if self.worse else "equal within the noise."
        if self.worse:
            return f"{found} Stop: the drive of the previous trial is kept."
        if self.finished and self.unsure:
            lines = number_of(self.unsure, "spectral line")
            where = f" from {self.limit_hz:.4g} Hz" if self.limit_hz else ""
            return (
                f"{found} Keep this drive: an error remains at {lines}, but the model is too "
                f"uncertain{where} to learn from it. Use a better model, or state a smaller uncertainty."
            )
        if self.finished:
            return f"{found} Only sensor noise remains: keep this drive."
        limit = (
            "" if np.isinf(self.limit_hz) else f" Above {self.limit_hz:.4g} Hz the model is too uncertain."
        )
        lines = number_of(self.learnt, "spectral line")
        left = f"at most {100.0 * self.slowest:.2g} % of the error there remains after the next trial"
        if self.slowest >= 1.0:
            left = "the error there can still grow"
        return (
            f"{found} Go on: play the new drive, corrected at {lines}. If the actuator is within the stated "
            f"deviations of its model, {left}.{limit}"
        )


def ilc_update(
    model: HammersteinModel,
    law: Law[Any],
    reference_um: Array,
    drive_v: Array,
    measured_um: Array,
    uncertainty: ModelUncertainty | None = None,
    sensor_bandwidth_hz: float = np.inf,
) -> IlcUpdate:
    """Learn from a trial.

    The error corrected for the sensor's lag, ``E = R - Y / S``, is added to the response of the model to the
    last drive, where it exceeds the noise and the model is certain enough (``ModelUncertainty``); the inverse
    of the model gives the drive of that path.

    Parameters
    ----------
    model, law : the model and its inverse, designed for the drive
    reference_um : (p, N) one period, counted from the start
    drive_v : (m, N) the period of the trial
    measured_um : (p, periods N) settled periods of readings, zero at the initial position
    uncertainty : relative uncertainty of the model
    sensor_bandwidth_hz : first-order lag of the sensor

    Raises
    ------
    InputError : no whole number of periods, or fewer than three
    """
    samples, time_s = reference_um.shape[1], model.instruments.drive.sample_time_s
    mean, deviation, freedom = _mean_period(measured_um, samples)
    frequency: Array = np.asarray(np.fft.rfftfreq(samples, time_s), dtype=np.float64)
    lag = 1.0 / (1.0 + 1j * frequency / sensor_bandwidth_hz)
    error = np.fft.rfft(reference_um, axis=1) - mean / lag
    noise = deviation / np.abs(lag)
    delta = (uncertainty or ModelUncertainty()).relative(model, frequency, time_s).T
    share = ModelUncertainty.share(delta)
    remains = np.abs(error * lag) > _least_error(deviation, freedom)
    above_noise = remains & (share > 0.0)
    drive = drive_v
    if above_noise.any():
        now, _ = Player(model, law.range).settled(drive_v)
        change = np.fft.irfft(np.where(above_noise, share * error, 0.0), samples, axis=1)
        drive, _ = centred(law, model, now + change)
    slowest = float((1.0 - share[above_noise] * (1.0 - delta[above_noise])).max(initial=0.0))
    unsure_at = frequency[(share == 0.0).any(axis=0)]
    read = _rms_of(deviation, samples)
    return IlcUpdate(
        drive,
        np.fft.irfft(error, samples, axis=1),
        read,
        _rms_of(noise, samples) / read if read else 1.0,
        _doubt(error, noise, samples, freedom.max()),
        int(above_noise.sum()),
        int((remains & (share == 0.0)).sum()),
        slowest,
        float(unsure_at.min(initial=np.inf)),
    )


def _least_error(deviation: Array, freedom: Array) -> Array:
    """Size of a line that noise alone reaches as seldom as normal noise reaches three deviations.

    The deviation of a line is known from few periods, so its ratio to the mean follows an F distribution; no
    line is quieter than the white noise under the spectrum, estimated from the median of all.
    """
    from scipy.special import chdtrc, fdtri

    parts = freedom / freedom[0]
    factor = np.sqrt(fdtri(parts, freedom, 1.0 - chdtrc(parts, parts * SIGNIFICANT**2)))
    white = np.sqrt(np.median(deviation**2, axis=1, keepdims=True) / (1.0 - 2.0 / (3.0 * freedom.max())))
    return np.asarray(np.maximum(factor * deviation, SIGNIFICANT * white))


def _rms_of(lines: Array, samples: int) -> float:
    """Rms over time and outputs of signals with lines (p, line) of a real spectrum of so many samples."""
    return float(np.sqrt(np.sum(_counted(lines, samples) * np.abs(lines) ** 2) / (len(lines) * samples**2)))


def _doubt(error: Complex, noise: Array, samples: int, freedom: float) -> float:
    """Bound of the noise in the mean square of an error (p, line), see ``IlcUpdate.doubt_um2``.

    The mean square is a sum over lines of |E + n|^2, each of variance 2 |E|^2 s^2 + s^4, and twice that where
    lines are real. Where one has nearly all of it, its deviation is known from as few periods as that line's.
    """
    from scipy.special import ndtr, stdtrit

    parts = _counted(error, samples)
    weight = parts / (len(error) * samples**2)
    known = np.maximum(np.abs(error) ** 2 - noise**2, 0.0)
    variance = float(np.sum(weight**2 * 2.0 / parts * (2.0 * known * noise**2 + noise**4)))
    return float(stdtrit(freedom, ndtr(SIGNIFICANT))) * float(np.sqrt(variance))


def _counted(lines: Array | Complex, samples: int) -> Array:
    """How often each line of a real spectrum counts in the energy: all but the first and the last twice."""
    count = np.full(lines.shape[1], 2.0)
    count[[0, -1] if samples % 2 == 0 else 0] = 1.0
    return count


def _mean_period(measured_um: Array, samples: int) -> tuple[Complex, Array, Array]:
    """Lines (p, line) of the mean period, their standard deviations, and degrees of freedom (line,) of these.

    Periods of white noise do not depend on each other. If s^2 is the variance of the steps of a random walk
    from period to period, n periods scatter by n s^2 / 6, their mean has the variance n s^2 / 3, and the
    start of the first that of all steps since the sensor read zero.
    """
    periods = measured_um.shape[1] // samples
    if measured_um.shape[1] % samples or periods < LEAST_PERIODS:
        raise InputError(
            MEASURED,
            f"has {measured_um.shape[1]} samples; give whole periods of {samples} samples, "
            f"{LEAST_PERIODS} or more, recorded after the path has settled",
        )
    lines = np.fft.rfft(measured_um.reshape(len(measured_um), periods, samples), axis=2)
    parts = _counted(lines[0], samples)  # one number or two
    scatter = lines.var(axis=1, ddof=1)
    drift = 6.0 * (SETTLING + 1.0 / 3.0)
    variance = scatter * np.where(_drifts(lines, scatter, parts), drift, 1.0 / periods)
    return lines.mean(axis=1), np.sqrt(variance), parts * (periods - 1.0)


def _drifts(lines: Complex, scatter: Array, parts: Array) -> Array:
    """Which lines (p, line) of the spectra (p, period, line) change more slowly than white noise would.

    Half the mean square of successive differences, over the variance, is 1 for white noise and 2 / n for n
    periods of a random walk. For white noise, a beta distribution with its ends and variance is close.

    Source: J. von Neumann, Distribution of the ratio of the mean square successive difference to the
    variance, Annals of Mathematical Statistics 12 (1941) 367-395.
    """
    from scipy.special import betainc, chdtri

    n = lines.shape[1]
    half, freedom = np.cos(np.pi / n), parts * (n - 1)
    shape = (half**2 * freedom * (freedom + 2.0) / (parts * (n - 2)) - 1.0) / 2.0
    steps = 0.5 * (np.abs(np.diff(lines, axis=1)) ** 2).mean(axis=1)
    ratio = steps / np.maximum(scatter, np.finfo(float).tiny)
    excess = scatter[:, 0] > np.median(scatter, axis=1) * chdtri(n - 1, RANDOM) / (n - 1)
    chance = np.full(scatter.shape, RANDOM / len(parts))
    chance[:, 0] = np.where(excess, RANDOM_EXCESS, RANDOM_OFFSET)
    below = betainc(shape, shape, np.clip((ratio - 1.0 + half) / (2.0 * half), 0.0, 1.0))
    return np.asarray((below < chance) & (scatter > 0.0))


def learn_from_files(
    model_path: str,
    path: Path,
    law: str,
    options: Mapping[str, Any],
    trial: tuple[Path, Path],
    uncertainty: ModelUncertainty,
    terms: Terms,
    onlooker: Onlooker = UNWATCHED,
    before: tuple[Path, Path] | None = None,
) -> tuple[Cycle, IlcUpdate]:
    """Next period of voltages, and the update from the trial.

    Parameters
    ----------
    path : one period of the path
    trial : the drive file of the trial, and the readings: ``time_s`` and one column per output in um,
        whole settled periods, zero at the initial position
    uncertainty : relative uncertainty of the model
    onlooker : receives the cost of the path before the work
    before : the files of the previous trial; its drive is kept if this trial was worse

    Raises InputError for files that do not belong together, and the errors of ``cycle_of``.
    """
    design = design_of(model_path, path, law, options, terms, onlooker)
    found, _ = _taught(design, trial, uncertainty, terms.units)
    if before is not None:
        found = found.after(*_taught(design, before, uncertainty, terms.units))
    try:
        return design.of_trial(found.drive_v, terms), found
    except SimulationError as error:
        asks = f"{trial[1]} asks for more than the range: check first that its zero is the initial position"
        raise SimulationError(f"{asks}. {error}") from None


def _taught(
    design: Design, trial: tuple[Path, Path], uncertainty: ModelUncertainty, units: str | None
) -> tuple[IlcUpdate, Array]:
    """What the files of a trial teach, and its drive (m, N)."""
    samples, time_s = design.reference_um.shape[1], design.model.instruments.drive.sample_time_s
    drive = _drive_of(trial[0], design.model, samples)
    _, measured, resampled = read_path(
        trial[1], design.model, time_s, "reading", CYCLE_COST, units=units, periodic=True
    )
    if resampled:
        raise InputError(
            str(trial[1]), f"is not sampled every {interval(time_s)} like the drive; record it like that"
        )
    _refuse_other_motion(str(trial[1]), design, drive, measured)
    bandwidth = design.model.instruments.sensor.bandwidth_hz
    with naming(str(trial[1]), instead_of=MEASURED):
        found = ilc_update(
            design.model, design.law, design.reference_um, drive, measured, uncertainty, bandwidth
        )
    return found, drive


def _refuse_other_motion(source: str, design: Design, drive: Array, measured: Array) -> None:
    """Refuse readings (p, periods N) of the motion that a drive (m, N) makes, in another unit or shifted.

    Learnt, they would ask for a drive that is far off.
    """
    time_s, samples = design.model.instruments.drive.sample_time_s, drive.shape[1]
    if measured.shape[1] % samples:
        return  # not whole periods, which are refused later
    expected, _ = Player(design.model, design.law.range).settled(drive)
    read = measured.reshape(len(measured), -1, samples).mean(axis=1)
    for name, e, m in zip(design.model.outputs, expected, read, strict=True):
        e, m = e - e.mean(), m - m.mean()
        if rms(m - e) <= OTHER * rms(e):
            continue
        gains = np.fft.irfft(np.conj(np.fft.rfft(e)) * np.fft.rfft(m), samples) / (e @ e)
        late = int(np.argmax(gains))
        gain = float(gains[late])
        if rms(m - gain * np.roll(e, late)) > OTHER * rms(m):
            continue
        if abs(np.log10(gain)) > 1.0:
            what = f"moves {gain:.2g} times as far as the drive moves the model"
            unit = {3: f": {name}_nm", -3: f": {name}_mm"}.get(round(np.log10(gain)), "")
            raise InputError(source, f"{name} {what}; name the unit of its numbers in the header{unit}")
        time = interval(min(late, samples - late) * time_s)
        what = f"comes {time} {'later' if 2 * late < samples else 'earlier'} than the drive moves the model"
        raise InputError(source, f"{name} {what}; record whole periods from the first row of the drive on")


def _drive_of(path: Path, model: HammersteinModel, samples: int) -> Array:
    """Voltages (m, N) of a drive file, by the names of its columns."""
    _, values, names = read_signal(path)
    wanted = [column("drive", name, "v") for name in model.inputs]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise InputError(str(path), f"has no column {missing[0]}; give the drive file of this trial")
    drive = np.ascontiguousarray(values[[names.index(name) for name in wanted]])
    if drive.shape[1] != samples:
        what = f"has {drive.shape[1]} rows, but a period of the path has {samples}"
        raise InputError(str(path), f"{what}; make the first drive with --cycle")
    return drive


class LearnedLaw(Learner):
    """Iterative learning on the model's own inverse, see ``ilc_update``.

    The first trial plays the settled period of the inverse. Each further trial corrects the drive before it
    by the sensor's readings.

    Parameters
    ----------
    model, inverse : model of the actuator, and its inverse, designed for the drive
    uncertainty : relative uncertainty of the model
    trial : number of the measured trial
    """

    def __init__(
        self, model: HammersteinModel, inverse: Law[Any], uncertainty: ModelUncertainty, trial: int = 1
    ):
        self.model, self.inverse, self.uncertainty, self.trial = model, inverse, uncertainty, trial
        self.n_inputs, self.n_outputs, self.range = inverse.n_inputs, inverse.n_outputs, inverse.range

    def first(self, reference_um: Array) -> Array:
        """Voltages of the inverse, see ``Learner.first``."""
        return centred(self.inverse, self.model, reference_um)[0]

    def following(
        self,
        reference_um: Array,
        drive_v: Array,
        reading_um: Array,
        before: tuple[Array, Array] | None = None,
    ) -> Array:
        """Voltages after an update; those of the previous trial if this one was worse beyond the noise."""
        bandwidth = self.model.instruments.sensor.bandwidth_hz
        known = (self.model, self.inverse, reference_um)
        taught = ilc_update(*known, drive_v, reading_um, self.uncertainty, bandwidth)
        if before is not None:
            taught = taught.after(ilc_update(*known, *before, self.uncertainty, bandwidth), before[0])
        return taught.drive_v

    def statement(self) -> str:
        """Statement of the inverse, and the need of a sensor."""
        own = f"The results are those of trial {self.trial}; each trial uses the readings of the one before."
        return f"{own} {self.inverse.statement()}".strip()


class Learned(Compensator):
    """Iterative learning from a sensor, on the inverse of the model."""

    law: Literal["learned"] = "learned"
    inverse: Literal["exact_inverse", "hammerstein_inverse"] = Field(
        default="hammerstein_inverse", description="law that computes the drive of a path"
    )
    filter_hz: Frequency | None = Field(
        default=None, description="bandwidth of the reference filter of hammerstein_inverse"
    )
    weights: Deviation = Field(
        default=WEIGHTS, description="relative standard deviation of the model's weights"
    )
    resonance: Deviation = Field(
        default=RESONANCE, description="relative standard deviation of the model's resonances"
    )
    trial: Trial = Field(default=5, description="number of the measured trial; the first is without learning")

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> LearnedLaw:
        """Build the learner, see ``Compensator.design``."""
        filtered = {} if self.filter_hz is None else {"filter_hz": self.filter_hz}
        asked: dict[str, Any] = {"law": self.inverse, **filtered}
        inverse = COMPENSATORS.value(asked).design(model, range_v, sample_time_s)
        assert isinstance(inverse, Law)  # each that may be named is one
        return LearnedLaw(model, inverse, ModelUncertainty(self.weights, self.resonance), self.trial)


COMPENSATORS.register(Learned)
