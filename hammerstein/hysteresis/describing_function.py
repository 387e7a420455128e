"""Describing function of a bank of play operators behind a drive with limited range."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import partial
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, Complex
from hammerstein.errors import InputError
from hammerstein.hysteresis.pair import Pair

if TYPE_CHECKING:
    from hammerstein.blocks.limit_cycles import HysteresisNonlinearity
    from hammerstein.hysteresis.kind import Hysteresis


HARMONIC_SAMPLES = 8192
"""Samples of a cycle from which a first harmonic is taken; its error falls with their square."""


def describing_function(pair: Pair, amplitude_v: ArrayLike, range_v: float = np.inf) -> Complex:
    """First-harmonic gain for a sine, clipped by the range of the drive and passed through the plays.

    For u = A sin(t), cut at +-L, the plays see the peak M = min(A, L). With

        f(x) = 2/pi (arcsin x + x sqrt(1 - x^2))

    the settled loop has, over the thresholds r_i below M,

        N(A) = sum of w_i { [f(M/A) + f((M - 2 r_i)/A)] / 2  -  4j r_i (M - r_i) / (pi A^2) }

    The plays see the cut sine, so the two describing functions do not multiply. On the rising half, the play
    stays at -(M - r) until u = 2 r - M, follows u - r until u = M, and stays at M - r. This half gives the
    real part; the area 4 r (M - r) of the loop gives the imaginary part.

    Parameters
    ----------
    pair : the operators
    amplitude_v : amplitudes A of the sine asked for [V], above zero
    range_v : range L of the drive, the same on both sides [V]; inf: none

    Returns
    -------
    N(A), in the shape of the amplitudes [um/V]; the phase is that of the output against the sine

    Raises
    ------
    InputError : an amplitude or range that is not above zero

    Source: without the range Gelb and Vander Velde, Multiple-Input Describing Functions and Nonlinear System
    Design (1968), table of describing functions (friction-controlled backlash of width 2 r); with the range
    this work, by the integral above.

    Examples
    --------
    A linear gain of 2 um/V behind a range of 1 V, at twice the range:

    >>> round(float(describing_function(Pair.linear(2.0), 2.0, range_v=1.0).real), 6)
    1.217996
    """
    asked = np.asarray(amplitude_v, dtype=np.float64)
    if not (asked > 0.0).all():
        raise InputError("amplitude_v", "must be above 0")
    if not range_v > 0.0:
        raise InputError("range_v", f"is {range_v:g}; it must be above 0")
    peak, r = np.minimum(asked, range_v)[..., None], pair.thresholds_v
    moving = r < peak
    real = 0.5 * (_share(peak / asked[..., None]) + _share((peak - 2.0 * r) / asked[..., None]))
    lost = 4.0 * r * (peak - r) / (np.pi * asked[..., None] ** 2)
    gains = np.where(moving, real - 1j * lost, 0.0)
    return np.asarray(gains @ pair.weights_um_per_v)


def _share(x: Array) -> Array:
    """f(x) = 2/pi (arcsin x + x sqrt(1 - x^2)), the describing function of a cut at x times the amplitude."""
    within = np.clip(x, -1.0, 1.0)
    return np.asarray(2.0 / np.pi * (np.arcsin(within) + within * np.sqrt(1.0 - within**2)))


class Describable(ABC):
    """Ability of a kind with wiping-out: first harmonic of one pair, for python-control."""

    @property
    @abstractmethod
    def reversals_v(self) -> Array:
        """Reversals after which operators of the first pair move, sorted [V]."""

    def first_harmonic(self, amplitude_v: float, range_v: float) -> complex:
        """Gain of the first harmonic [um/V] of the settled loop of one pair, from its samples.

        The second cycle of a sine about the working point, cut at the range, is settled.

        amplitude_v : amplitude of the sine asked for [V]
        range_v : range of the drive, the same on both sides [V]
        """
        angle = 2.0 * np.pi * np.arange(2 * HARMONIC_SAMPLES) / HARMONIC_SAMPLES
        u = np.clip(amplitude_v * np.sin(angle), -range_v, range_v)
        settled = cast("Hysteresis[Any]", self).respond(u[None])[0][0, HARMONIC_SAMPLES:]
        return complex(2j * np.mean(settled * np.exp(-1j * angle[HARMONIC_SAMPLES:])) / amplitude_v)

    def to_describing_function(self, range_v: float = np.inf) -> HysteresisNonlinearity:
        """Return a block of one pair, behind a drive, as ``control.DescribingFunctionNonlinearity``.

        Sines go about the working point.

        Parameters
        ----------
        range_v : range of the drive, the same on both sides of the working point [V]; inf: none

        Raises
        ------
        InputError : more than one input or output, or a range within which no operator moves
        """
        from hammerstein.blocks.limit_cycles import HysteresisNonlinearity

        hysteresis = cast("Hysteresis[Any]", self)
        if (hysteresis.n_outputs, hysteresis.n_inputs) != (1, 1):
            axes = hysteresis.ports
            raise InputError(
                "describing function", f"needs a single pair; the block has {axes}: give one pair of it"
            )
        state: Any = hysteresis.rest()
        smallest, largest = float(self.reversals_v[0]), float(self.reversals_v[-1])
        if not range_v > smallest:
            raise InputError("range_v", f"is {range_v:g}: nothing moves below {smallest:g} V")

        def move(u_v: float) -> float:
            nonlocal state
            v_um, state = hysteresis.step([min(max(u_v, -range_v), range_v)], state)
            return float(v_um[0])

        scale = max(largest, 1.0) if np.isinf(range_v) else range_v
        of_amplitude = partial(self.first_harmonic, range_v=range_v)
        return HysteresisNonlinearity(of_amplitude, move, (smallest or 1e-3 * scale, 100.0 * scale))
