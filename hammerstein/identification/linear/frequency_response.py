"""Frequency response of an actuator with several inputs and outputs, without a model.

The lines at which it can be told come from the excitation itself; where the experiments do not move the
inputs independently of each other, no response is invented.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hammerstein.arrays import Array, Complex, freeze
from hammerstein.errors import IdentificationError, InputError
from hammerstein.records.record import Record

EXCITED = 1e-5
"""Part of the strongest line's power from which a line counts as excited: harmonics and noise stay below."""

SEPARATED = 1e-3
"""Smallest eigenvalue of the inputs' coherence matrix at which they count as moving independently."""

SEGMENTS = 16
"""Segments cut from the shortest experiment."""

HANN_OVERLAP = 18.0 / 19.0
"""Independent averages a segment: Hann windows that overlap by half share (1/6)^2 of their power."""


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Frequency response of p outputs to m inputs at F lines.

    Parameters
    ----------
    frequency_hz : (F,) lines [Hz], increasing
    response : (p, m, F) complex gain [output / input], for example [um/V]
    coherence : (p, F) multiple coherence: fraction of an output's power that the inputs explain linearly
    input_power : (m, m, F) mean of U U^H over the experiments [input^2]
    residual_power : (p, F) output power that the inputs do not explain: noise and distortion [output^2];
        if there are only as many experiments as inputs, the noise between periods, or 0
    sample_time_s : time between two samples of the records [s]
    """

    frequency_hz: Array
    response: Complex
    coherence: Array
    input_power: Complex
    residual_power: Array
    sample_time_s: float

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value = np.array(value, order="C")
                freeze(value)
                object.__setattr__(self, item.name, value)

    @property
    def output_power(self) -> Array:
        """Power (p, F) of each output: the linearly explained part and the residue [output^2]."""
        explained = np.einsum("ijf,jkf,ikf->if", self.response, self.input_power, self.response.conj())
        return np.asarray(explained.real + self.residual_power)


class _Blocks(NamedTuple):
    """Spectra of the parts that are averaged: ``U`` (F, m, block), ``Y`` (F, p, block)."""

    frequency_hz: Array
    U: Complex
    Y: Complex
    independent: float
    noise_variance: Array | None


def measured_response(records: Sequence[Record], v_um: Sequence[Array] | None = None) -> FrequencyResponse:
    """Frequency response from the voltages, or from the output of the static block, to the readings."""
    period = records[0].period_samples
    same = all(record.period_samples == period for record in records)
    return frequency_response(
        [record.u_v for record in records] if v_um is None else v_um,
        [record.y_um for record in records],
        records[0].sample_time_s,
        period_samples=period if same else None,
    )


def frequency_response(
    u: Sequence[Array], y: Sequence[Array], sample_time_s: float, *, period_samples: int | None = None
) -> FrequencyResponse:
    """Estimate the frequency response from one or more experiments on one actuator.

        G(f) = S_yu(f) S_uu(f)^-1,   S_yu = mean of Y U^H,   S_uu = mean of U U^H      (H1)

    Periodic excitation (``period_samples`` given): each experiment gives one spectrum, from the mean of its
    whole periods in steady state, at the excited lines. There is no leakage, so noise-free data give the
    exact response. It needs as many experiments as inputs, for example orthogonal multisines or one input
    driven at a time.

    Other excitation (``period_samples`` absent): Hann segments that overlap by half, a ninth of the shortest
    experiment long, at least 32 and at most 8192 samples. The two lowest lines hold the offset and are
    excluded. Segments must be several times longer than the slowest ringing; shorter ones flatten the
    resonance.

    Parameters
    ----------
    u, y : (m, sample) and (p, sample) of each experiment
    sample_time_s : time between two samples [s]
    period_samples : length of one period [samples]; periods are counted from the end of each experiment

    Raises
    ------
    InputError : experiments that are too short for the period or for segments
    IdentificationError : an input never driven; inputs that always move together; too little data

    References
    ----------
    Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., sections 2.6 and 2.7.

    Examples
    --------
    >>> u = np.random.default_rng(1).standard_normal((2, 2, 64))           # experiment, input, sample
    >>> u = np.concatenate([u, u], axis=2)                                 # two periods
    >>> y = [np.array([[2.0, -1.0]]) @ one for one in u]                   # y = 2 u1 - u2
    >>> g = frequency_response(list(u), y, 1e-3, period_samples=64)
    >>> g.response.shape, np.allclose(g.response, [[[2.0], [-1.0]]])
    ((1, 2, 31), True)
    """
    if period_samples is None:
        blocks = _segments(u, y, sample_time_s)
    else:
        blocks = _periods(u, y, sample_time_s, period_samples)
    return _estimate(blocks, _separable_lines(blocks), sample_time_s)


def _periods(inputs: Sequence[Array], outputs: Sequence[Array], sample_time_s: float, period: int) -> _Blocks:
    """One block an experiment: the spectrum of its mean period."""
    shortest = min(u.shape[1] for u in inputs)
    if period < 4 or shortest < period:
        raise InputError(
            "period_samples",
            f"a period of {period} samples does not fit into {shortest} samples; give the true period "
            "(at least 4)",
        )
    lines = np.arange(1, (period + 1) // 2)  # neither the mean nor the Nyquist line
    U = [_period_spectra(u, period)[..., lines] for u in inputs]
    Y = [_period_spectra(y, period)[..., lines] for y in outputs]
    noise = None
    if min(map(len, Y)) > 1:
        # variance of each experiment's mean, averaged over the experiments
        noise = np.mean([np.var(y, axis=0, ddof=1) / len(y) for y in Y], axis=0)
    return _Blocks(
        lines / (period * sample_time_s),
        np.stack([u.mean(axis=0) for u in U]).transpose(2, 1, 0),
        np.stack([y.mean(axis=0) for y in Y]).transpose(2, 1, 0),
        float(len(U)),
        noise,
    )


def _period_spectra(x: Array, period: int) -> Complex:
    """Spectra (period, axis, line) of the whole periods at the end of a record."""
    count = x.shape[1] // period
    whole = x[:, x.shape[1] - count * period :].reshape(len(x), count, period)
    return np.asarray(np.fft.rfft(whole, axis=2).swapaxes(0, 1) / period)


def _segments(inputs: Sequence[Array], outputs: Sequence[Array], sample_time_s: float) -> _Blocks:
    """One block a Hann segment, half overlapping."""
    shortest = min(u.shape[1] for u in inputs)
    length = int(np.clip(2 * shortest // (SEGMENTS + 1), 32, 8192))
    if shortest < length:
        raise InputError("records", f"segments of {length} samples cannot be cut from {shortest} samples")
    lines = np.arange(2, (length + 1) // 2)
    U = np.concatenate([_segment_spectra(u, length)[..., lines] for u in inputs])
    Y = np.concatenate([_segment_spectra(y, length)[..., lines] for y in outputs])
    return _Blocks(
        lines / (length * sample_time_s),
        U.transpose(2, 1, 0),
        Y.transpose(2, 1, 0),
        max(1.0, HANN_OVERLAP * len(U)),
        None,
    )


def _segment_spectra(x: Array, length: int) -> Complex:
    """Spectra (segment, axis, line), scaled so that a line's power is that of a sine in it."""
    window = np.hanning(length + 1)[:-1]
    cut = np.lib.stride_tricks.sliding_window_view(x, length, axis=1)[:, :: max(1, length // 2)]
    return np.asarray(np.fft.rfft(cut * window, axis=2).swapaxes(0, 1) / window.sum())


def _separable_lines(blocks: _Blocks) -> NDArray[np.intp]:
    """Lines at which every input is driven, and independently of the others."""
    m, f = blocks.U.shape[1], blocks.frequency_hz
    power = np.mean(np.abs(blocks.U) ** 2, axis=2)
    still = np.flatnonzero(power.max(axis=0) == 0.0)
    if still.size:
        raise IdentificationError(
            f"{_named(still)} never driven and therefore not identifiable: drive it, or remove it"
        )
    lines = np.flatnonzero(np.all(power >= EXCITED * power.max(axis=0), axis=1))
    if not lines.size:
        raise IdentificationError(
            f"no line between {f[0]:g} and {f[-1]:g} Hz is excited by every input: drive all inputs over the "
            "same band"
        )
    scaled = blocks.U[lines] / np.sqrt(power[lines])[:, :, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.conj().swapaxes(1, 2) / blocks.U.shape[2])
    separable = values[:, 0] > SEPARATED
    if separable.mean() < 0.5:
        blend = np.median(np.abs(vectors[~separable, :, 0]), axis=0)
        together = np.flatnonzero(blend > 0.2 * blend.max())
        raise IdentificationError(
            f"{_named(together)} not moved independently at {np.sum(~separable)} of {lines.size} "
            f"lines ({blocks.U.shape[2]} spectra for {m} inputs), so the records cannot separate "
            "their effects: drive one input at a time, or all with uncorrelated signals, in as many "
            "experiments as inputs"
        )
    return np.asarray(lines[separable])


def _named(indices: NDArray[np.intp]) -> str:
    names = [str(i + 1) for i in indices]
    if len(names) == 1:
        return f"input {names[0]} is"
    return f"inputs {', '.join(names[:-1])} and {names[-1]} are"


def _estimate(blocks: _Blocks, lines: NDArray[np.intp], sample_time_s: float) -> FrequencyResponse:
    U, Y = blocks.U[lines], blocks.Y[lines]
    m, count = U.shape[1:]
    conjugate = U.conj().swapaxes(1, 2)
    s_uu = U @ conjugate / count
    response = np.linalg.solve(s_uu.swapaxes(1, 2), (Y @ conjugate / count).swapaxes(1, 2)).swapaxes(1, 2)
    explained = np.mean(np.abs(response @ U) ** 2, axis=2)
    residue = np.zeros_like(explained)
    if (free := blocks.independent - m) > 0.0:
        # the fit itself has taken m of the spectra's freedom
        residue = np.mean(np.abs(Y - response @ U) ** 2, axis=2) * (blocks.independent / free)
    elif blocks.noise_variance is not None:
        residue = blocks.noise_variance.T[lines]
    total = explained + residue
    return FrequencyResponse(
        frequency_hz=blocks.frequency_hz[lines],
        response=response.transpose(1, 2, 0),
        coherence=np.divide(explained, total, out=np.zeros_like(total), where=total > 0.0).T,
        input_power=s_uu.transpose(1, 2, 0),
        residual_power=residue.T,
        sample_time_s=float(sample_time_s),
    )
