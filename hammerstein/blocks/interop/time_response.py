"""Signals to ``control.TimeResponseData`` and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import control
import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError


class TimeTrace(NamedTuple):
    """One trace: time (sample,) [s], inputs (input, sample) and outputs (output, sample)."""

    time_s: Array
    inputs: Array
    outputs: Array


def time_response(
    time_s: Array, outputs: Mapping[str, Array], inputs: Mapping[str, Array], title: str = "Response"
) -> control.TimeResponseData:
    """Signals (sample,) by name as one trace."""
    return control.TimeResponseData(
        time_s,
        np.array(list(outputs.values())),
        inputs=np.array(list(inputs.values())),
        output_labels=list(outputs),
        input_labels=list(inputs),
        issiso=False,
        title=title,
        sysname="actuator",
    )


def traces_of(
    data: control.TimeResponseData, inputs: Sequence[str], outputs: Sequence[str]
) -> Iterator[TimeTrace]:
    """Every trace of a time response, of the signals with these labels.

    Raises InputError where there are no inputs, or no such signal.
    """
    if data.u is None:
        raise InputError("time response", "holds no inputs; a record needs the input signal")
    rows_in = _rows(data.input_labels, inputs, "input")
    rows_out = _rows(data.output_labels, outputs, "output")
    for u, y in zip(_by_trace(data.u), _by_trace(data.y), strict=True):
        yield TimeTrace(np.asarray(data.t, dtype=np.float64), u[rows_in], y[rows_out])


def _by_trace(values: Array) -> list[Array]:
    """Signals (axis, sample) of each trace, from (axis, sample) or (axis, trace, sample)."""
    return [values] if values.ndim == 2 else list(np.swapaxes(values, 0, 1))


def _rows(labels: Sequence[str], wanted: Sequence[str], kind: str) -> list[int]:
    missing = [name for name in wanted if name not in labels]
    if missing:
        known = ", ".join(labels)
        raise InputError("time response", f"has no {kind} {', '.join(missing)}; it has {known}")
    return [list(labels).index(name) for name in wanted]
