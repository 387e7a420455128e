"""Frequency response of an actuator with several inputs and outputs, without a model.

The lines at which it can be told come from the excitation itself; where the experiments do not move the
inputs independently of each other, no response is invented.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hammerstein.arrays import Array, Complex, freeze
from hammerstein.errors import IdentificationError, InputError

EXCITED = 1e-5
"""Part of the strongest line's power from which a line counts as excited: harmonics and noise stay below."""

SEPARATED = 1e-3
"""Smallest eigenvalue of the inputs' coherence matrix at which they count as moving independently."""

SEGMENTS = 16
"""Segments cut from the shortest experiment where the caller does not choose their length."""

HANN_OVERLAP = 18.0 / 19.0
"""Independent averages a segment: Hann windows that overlap by half share (1/6)^2 of their power."""


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Frequency response of p outputs to m inputs at F lines, with its uncertainty.

    Parameters
    ----------
    frequency_hz : (F,) lines [Hz], increasing
    response : (p, m, F) complex gain [output / input], for example [um/V]
    coherence : (p, F) multiple coherence: fraction of an output's power that the inputs explain linearly
    input_power : (m, m, F) mean of U U^H over the experiments [input^2]
    residual_power : (p, F) output power that the inputs do not explain: noise and distortion [output^2];
        if there are only as many experiments as inputs, the noise between periods, or 0
    sample_time_s : time between two samples of the records [s]
    variance : (p, m, F) variance of ``response`` due to this residue; None if it cannot be estimated
    noise_variance : (p, F) variance of the averaged output spectrum due to noise alone, from the differences
        between periods [output^2]; None for a single period or for excitation that is not periodic
    """

    frequency_hz: Array
    response: Complex
    coherence: Array
    input_power: Complex
    residual_power: Array
    sample_time_s: float
    variance: Array | None = None
    noise_variance: Array | None = None

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


def frequency_response(
    u: ArrayLike | Sequence[ArrayLike],
    y: ArrayLike | Sequence[ArrayLike],
    sample_time_s: float,
    *,
    period_samples: int | None = None,
    settle_periods: int = 0,
    segment_samples: int | None = None,
    band_hz: tuple[float, float] | None = None,
) -> FrequencyResponse:
    """Estimate the frequency response from one or more experiments on one actuator.

        G(f) = S_yu(f) S_uu(f)^-1,   S_yu = mean of Y U^H,   S_uu = mean of U U^H      (H1)

    Periodic excitation (``period_samples`` given): each experiment gives one spectrum, from the mean of its
    whole periods in steady state, at the excited lines. There is no leakage, so noise-free data give the
    exact response. It needs as many experiments as inputs, for example orthogonal multisines or one input
    driven at a time.

    Other excitation (``period_samples`` absent): Hann segments that overlap by half. The two lowest lines
    hold the offset and are excluded. Segments must be several times longer than the slowest ringing; shorter
    ones flatten the resonance.

    Parameters
    ----------
    u : (m, sample), or one such array for each experiment
    y : (p, sample), or one such array for each experiment
    sample_time_s : time between two samples [s]
    period_samples : length of one period [samples]; periods are counted from the end of each experiment
    settle_periods : excluded periods at the start of each experiment, for its transient
    segment_samples : length of one segment [samples]; a ninth of the shortest experiment, at least 32 and
        at most 8192, if not given
    band_hz : lowest and highest line to keep [Hz]

    Returns
    -------
    FrequencyResponse

    Raises
    ------
    InputError : wrong shapes, values that are not finite, a period or segment that does not fit
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
    inputs, outputs = _experiments(u, y, sample_time_s)
    if period_samples is None:
        blocks = _segments(inputs, outputs, sample_time_s, segment_samples)
    else:
        blocks = _periods(inputs, outputs, sample_time_s, period_samples, settle_periods)
    return _estimate(blocks, _separable_lines(blocks, band_hz), sample_time_s)


def _experiments(
    u: ArrayLike | Sequence[ArrayLike], y: ArrayLike | Sequence[ArrayLike], sample_time_s: float
) -> tuple[list[Array], list[Array]]:
    inputs, outputs = _arrays(u), _arrays(y)
    if len(inputs) != len(outputs) or not inputs:
        raise InputError(
            "records", f"{len(inputs)} experiments of inputs, {len(outputs)} of outputs; give equally many"
        )
    m, p = len(inputs[0]), len(outputs[0])
    for i, (a, b) in enumerate(zip(inputs, outputs, strict=True), start=1):
        name = f"experiment {i}"
        if a.ndim != 2 or b.ndim != 2 or a.shape != (m, a.shape[-1]) or b.shape != (p, a.shape[-1]):
            raise InputError(
                name,
                f"inputs have shape {a.shape}, outputs {b.shape}; give ({m}, samples) and ({p}, samples)",
            )
        if not (np.isfinite(a).all() and np.isfinite(b).all()):
            raise InputError(name, "holds values that are not finite; repair or cut the record")
    if not (np.isfinite(sample_time_s) and sample_time_s > 0.0):
        raise InputError("sample_time_s", f"is {sample_time_s:g}; it must be above 0")
    return inputs, outputs


def _arrays(values: ArrayLike | Sequence[ArrayLike]) -> list[Array]:
    if isinstance(values, np.ndarray) and values.ndim == 2:
        return [np.asarray(values, dtype=np.float64)]
    return [np.asarray(v, dtype=np.float64) for v in values]  # type: ignore[union-attr]


def _periods(
    inputs: list[Array], outputs: list[Array], sample_time_s: float, period: int, settle: int
) -> _Blocks:
    """One block an experiment: the spectrum of its mean period."""
    shortest = min(u.shape[1] for u in inputs)
    if period < 4 or settle < 0 or shortest < (settle + 1) * period:
        raise InputError(
            "period_samples",
            f"a period of {period} samples after {settle} settling periods does not fit into "
            f"{shortest} samples; give the true period (at least 4) and fewer settling periods",
        )
    lines = np.arange(1, (period + 1) // 2)  # neither the mean nor the Nyquist line
    U = [_period_spectra(u, period, settle)[..., lines] for u in inputs]
    Y = [_period_spectra(y, period, settle)[..., lines] for y in outputs]
    counts = np.array([len(y) for y in Y])
    noise = None
    if counts.min() > 1:
        # variance of each experiment's mean, averaged over the experiments
        noise = np.mean([np.var(y, axis=0, ddof=1) / len(y) for y in Y], axis=0)
    return _Blocks(
        lines / (period * sample_time_s),
        np.stack([u.mean(axis=0) for u in U]).transpose(2, 1, 0),
        np.stack([y.mean(axis=0) for y in Y]).transpose(2, 1, 0),
        float(len(U)),
        noise,
    )


def _period_spectra(x: Array, period: int, settle: int) -> Complex:
    """Spectra (period, axis, line) of the whole periods at the end of a record."""
    count = x.shape[1] // period - settle
    whole = x[:, x.shape[1] - count * period :].reshape(len(x), count, period)
    return np.asarray(np.fft.rfft(whole, axis=2).swapaxes(0, 1) / period)


def _segments(
    inputs: list[Array], outputs: list[Array], sample_time_s: float, segment: int | None
) -> _Blocks:
    """One block a Hann segment, half overlapping."""
    shortest = min(u.shape[1] for u in inputs)
    length = int(np.clip(2 * shortest // (SEGMENTS + 1), 32, 8192)) if segment is None else segment
    if length < 8 or shortest < length:
        raise InputError(
            "segment_samples",
            f"segments of {length} samples cannot be cut from {shortest} samples; "
            "choose at least 8 and at most the length of the shortest experiment",
        )
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


def _separable_lines(blocks: _Blocks, band_hz: tuple[float, float] | None) -> NDArray[np.intp]:
    """Lines at which every input is driven, and independently of the others."""
    m, f = blocks.U.shape[1], blocks.frequency_hz
    power = np.mean(np.abs(blocks.U) ** 2, axis=2)
    still = np.flatnonzero(power.max(axis=0) == 0.0)
    if still.size:
        raise IdentificationError(
            f"{_named(still)} never driven and therefore not identifiable: drive it, or remove it"
        )
    low, high = band_hz or (0.0, np.inf)
    band = (f >= low) & (f <= high)
    lines = np.flatnonzero(band & np.all(power >= EXCITED * power.max(axis=0), axis=1))
    if not lines.size:
        raise IdentificationError(
            f"no line between {max(low, f[0]):g} and {min(high, f[-1]):g} Hz is excited by every "
            "input: drive all inputs over the same band, or widen band_hz"
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
    noise = None if blocks.noise_variance is None else blocks.noise_variance.T[lines]
    residue = None
    if (free := blocks.independent - m) > 0.0:
        # the fit itself has taken m of the spectra's freedom
        residue = np.mean(np.abs(Y - response @ U) ** 2, axis=2) * (blocks.independent / free)
    elif noise is not None:
        residue = noise
    unexplained = np.zeros_like(explained) if residue is None else residue
    total = explained + unexplained
    variance = None
    if residue is not None:
        spread = np.diagonal(np.linalg.inv(s_uu), axis1=1, axis2=2).real / blocks.independent
        variance = (residue[:, :, None] * spread[:, None, :]).transpose(1, 2, 0)
    return FrequencyResponse(
        frequency_hz=blocks.frequency_hz[lines],
        response=response.transpose(1, 2, 0),
        coherence=np.divide(explained, total, out=np.zeros_like(total), where=total > 0.0).T,
        input_power=s_uu.transpose(1, 2, 0),
        residual_power=unexplained.T,
        sample_time_s=float(sample_time_s),
        variance=variance,
        noise_variance=None if noise is None else noise.T,
    )
