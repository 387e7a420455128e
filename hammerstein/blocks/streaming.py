"""A law in a loop that writes to a device: sample by sample or block by block."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.errors import InputError


class Stream:
    """A running law that holds its own state.

    A step creates no garbage, so the garbage collector does not pause it. The voltages equal those of
    ``law.step`` to the last bit.

    Attributes
    ----------
    law : the law
    state : state after the last sample; you may keep it and pass it in again, it is never modified

    Examples
    --------
    >>> import hammerstein
    >>> model = hammerstein.HammersteinModel.load("duo_bimorph_static")
    >>> law = hammerstein.ExactInverse().design(model, range_v=10.0, sample_time_s=50e-6)
    >>> loop = hammerstein.stream(law)
    >>> drive_v = loop.step([5.0, 0.0])
    >>> model.hysteresis.respond(drive_v[:, None])[0].round(9).ravel() + 0.0
    array([5., 0.])
    >>> loop.block([[6.0, 7.0], [0.0, 0.0]]).shape
    (2, 2)
    """

    def __init__(self, law: Law[Any], state: Any = None):
        self.law = law
        self.state = law.rest() if state is None else state
        self._drive = np.empty(law.n_inputs)
        idle = np.zeros((law.n_outputs, 1))  # compiles what is not yet: no sample waits for that
        law.step(idle[:, 0], self.state)
        law.respond(idle, self.state)

    def __repr__(self) -> str:
        return f"Stream({self.law!r})"

    def step(self, reference_um: ArrayLike) -> Array:
        """Voltages (m,) to send now for one sample of reference (p,); the same array in every step.

        Raises InputError for a reference that is not finite or has another number of axes; the memory is
        then that of the sample before.
        """
        drive, self.state = self.law.step(reference_um, self.state)
        self._drive[:] = drive
        return self._drive

    def block(self, reference_um: ArrayLike) -> Array:
        """Voltages (m, N) for a block of reference (p, N), of any length."""
        drive, self.state = self.law.respond(reference_um, self.state)
        return drive


def stream(compensator: Law[Any], state: Any = None) -> Stream:
    """Run a designed law in a loop of your own.

    Parameters
    ----------
    compensator : result of ``design``
    state : initial state, for example of another stream or from ``law.primed``; at rest if not given

    Raises
    ------
    InputError : a compensator that was not designed, or one that reads the sensor
    """
    if not isinstance(compensator, Law):
        what = type(compensator).__name__
        raise InputError(
            "stream",
            f"{what} is no sensorless law; design one first, as in ExactInverse().design(model, "
            "range_v, sample_time_s). For a controller that reads the sensor, call its methods "
            "request and correct",
        )
    return Stream(compensator, state)
