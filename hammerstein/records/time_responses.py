"""Records from time responses of python-control."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.errors import InputError
from hammerstein.records.checks import sample_time, time_mistakes
from hammerstein.records.record import Record

if TYPE_CHECKING:
    import control


def records_of_time_response(
    data: control.TimeResponseData,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
) -> tuple[Record, ...]:
    """Records of a ``control.TimeResponseData``, one for each trace, checked like those from files.

    Parameters
    ----------
    data : voltages [V] and displacements [um] over a uniform time [s]
    inputs, outputs : labels of voltages and displacements; default: all signals

    Raises
    ------
    InputError : no inputs, an unknown label, a time that is not uniform, and what ``Record`` raises

    Examples
    --------
    >>> import control
    >>> time_s = 1e-3 * np.arange(300)
    >>> data = control.forced_response(control.tf([5.0], [0.01, 1.0]), time_s, np.sin(40.0 * time_s))
    >>> records_of_time_response(data)
    (Record('time response': 300 samples of 0.001 s; u[0] -1 to 0.9999 V; y[0] -4.641 to 4.654 um),)
    """
    from hammerstein.blocks.interop.time_response import traces_of

    fed = tuple(inputs if inputs is not None else data.input_labels or ())
    read = tuple(outputs if outputs is not None else data.output_labels or ())
    traces = list(traces_of(data, fed, read))
    records = []
    for number, trace in enumerate(traces, start=1):
        source = "time response" if len(traces) == 1 else f"time response, trace {number}"
        mistakes = time_mistakes("time", trace.time_s, np.arange(1, len(trace.time_s) + 1))
        if mistakes:
            raise InputError(source, mistakes)
        records.append(Record(trace.inputs, trace.outputs, sample_time(trace.time_s), fed, read, source))
    return tuple(records)
