"""Measured records from files, and from time responses of python-control."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError, Mistake, all_of, refuse
from hammerstein.quantities import RATE_HZ, SCALE, interval
from hammerstein.records.checks import (
    hidden_gaps,
    moves,
    sample_time,
    still_mistake,
    time_mistakes,
    unit_mistake,
)
from hammerstein.records.readers import Columns, Header, named_time, read_array, read_columns
from hammerstein.records.record import Record
from hammerstein.signals.text_tables import where
from hammerstein.signals.units import BASE, Kind, axis_name, unit_in

if TYPE_CHECKING:
    import control


PathLike = str | Path

AXES = ("sample", "channel", "experiment", "period")
OTHER_RATE = 0.01
"""Relative difference allowed between a rate and the file's time column."""


def read_records(
    paths: Sequence[PathLike],
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    rate_hz: float | None = None,
    time: str | None = None,
    input_scale: float | None = None,
    output_scale: float | None = None,
    all_driven: bool = True,
) -> tuple[Record, ...]:
    """Read records of one actuator from files: CSV and other text, ``.npy``, ``.npz``, ``.mat``, Parquet.

    Several files are several experiments. A column is named as in the file, or by its number from 1; see
    `hammerstein.records.readers` for arrays with more than two axes and files with several variables.

    Parameters
    ----------
    paths : files
    inputs, outputs : columns with the voltages and the displacements; if not given, those with such a unit
    rate_hz : samples a second [Hz], or
    time : column with the time [s]; one of the two, or neither where one column has such a unit
    input_scale, output_scale : factors that turn the file's numbers into V and um; if not given, by the unit
        in the name of a column (``u [mV]``, ``x_nm``) or in a row of units, else 1
    all_driven : whether every input must be driven in some record, as identification needs it

    Raises
    ------
    InputError : every mistake of every file at once, with column and row
    """
    if paths and not isinstance(paths, str | Path):
        inputs, outputs, time = _chosen(paths[0], inputs, outputs, rate_hz, time)
    inputs, outputs, times = inputs or (), outputs or (), [] if time is None else [time]
    chosen, scales = {"inputs": inputs, "outputs": outputs, "time": times}, (input_scale, output_scale)
    _refuse_arguments(paths, chosen, rate_hz, scales)
    m, p, wanted = len(inputs), len(outputs), [*inputs, *outputs, *times]

    def read(path: PathLike) -> Record:
        columns = read_columns(path, wanted)
        found, factors = _factors_of(columns, m, p, scales)
        late, step = _sample_time_of(columns) if rate_hz is None else ([], 1.0 / rate_hz)
        refuse(columns.source, [*columns.mistakes, *found, *late])
        values = factors[:, None] * columns.values[: m + p]
        names = tuple(axis_name(name) for name in columns.names[: m + p])
        record = Record(values[:m], values[m:], step, names[:m], names[m:], columns.source, columns.rows)
        if rate_hz is not None:
            _refuse_other_time(path, rate_hz, wanted)
        return record

    return _checked(all_of(read, paths, "records"), all_driven)


def _chosen(
    path: PathLike,
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    rate_hz: float | None,
    time: str | None,
) -> tuple[Sequence[str], Sequence[str], str | None]:
    """Columns as they were named; those that were not are known by their units."""
    if inputs is not None and outputs is not None and (time is not None or rate_hz is not None):
        return inputs, outputs, time
    header, mistakes = Header.of(path), []
    named = {column for columns in (inputs, outputs) for column in columns or ()}
    found: dict[str, Sequence[str]] = {}
    asked: tuple[tuple[str, Kind, Sequence[str] | None], ...] = (
        ("inputs", "voltage", inputs),
        ("outputs", "displacement", outputs),
    )
    for option, kind, given in asked:
        found[option] = [c for c in header.measuring(kind) if c not in named] if given is None else given
        if given is None and not found[option]:
            what = f"no column has a unit of {kind} in its name; name the columns: {header.listed()}"
            mistakes.append(Mistake(f"{option} (--{option})", what))
    refuse(str(path), mistakes)
    if time is None and rate_hz is None:
        times = [column for column in header.measuring("time") if column not in named]
        time = times[0] if len(times) == 1 else None
    return found["inputs"], found["outputs"], time


def _refuse_arguments(
    paths: Sequence[PathLike],
    chosen: Mapping[str, Sequence[str]],
    rate_hz: float | None,
    scales: tuple[float | None, float | None],
) -> None:
    """Refuse arguments that do not fit together; the columns are ``chosen`` as inputs, outputs and time."""
    mistakes = []
    if isinstance(paths, str | Path):
        mistakes.append(Mistake("paths", "give a list of files"))
    elif not paths:
        mistakes.append(Mistake("paths", "no file was given"))
    for kind in ("inputs", "outputs"):
        if isinstance(chosen[kind], str) or not chosen[kind]:
            mistakes.append(Mistake(kind, "give a list of at least one column"))
    mistakes += _named_twice(chosen)
    if (rate_hz is None) == (not chosen["time"]):
        mistakes.append(
            Mistake("rate or time", "give one of them: the rate in Hz (--rate) or a column (--time)")
        )
    if rate_hz is not None and not RATE_HZ.holds(rate_hz):
        mistakes.append(Mistake("rate (--rate)", f"is {rate_hz:g} Hz; it {RATE_HZ.words()}"))
    for name, scale in zip(("input scale", "output scale"), scales, strict=True):
        if scale is not None and (not SCALE.holds(scale) or scale == 0):
            option = f"{name} (--{name.replace(' ', '-')})"
            mistakes.append(Mistake(option, f"is {scale:g}; it {SCALE.words()}, and not 0"))
    refuse("records", mistakes)


def _named_twice(chosen: Mapping[str, Sequence[str]]) -> Iterator[Mistake]:
    """Roles and options of each column that is named more than once."""
    named = [column for columns in chosen.values() for column in columns]
    for column in sorted({column for column in named if named.count(column) > 1}):
        kinds = " and ".join(f"{kind} (--{kind})" for kind, columns in chosen.items() if column in columns)
        yield Mistake(kinds, f"{column} is named twice; a column is one input, one output or the time")


def _factors_of(
    columns: Columns, m: int, p: int, scales: tuple[float | None, float | None]
) -> tuple[list[Mistake], Array]:
    """Factors from the file's numbers to V and um: as given, or by the units that the file names."""
    mistakes, factors = [], np.ones(m + p)
    kinds: tuple[tuple[Kind, str], ...] = (("voltage", "input"), ("displacement", "output"))
    for k in range(m + p):
        unit, scale, (kind, option) = unit_in(columns.units[k]), scales[k >= m], kinds[k >= m]
        if scale is not None:
            factors[k] = scale
        elif unit is not None and unit.kind == kind:
            factors[k] = unit.factor
        elif unit is not None and unit.kind != "time":
            mistakes.append(
                Mistake(
                    where(columns.names[k]),
                    f"is in {unit.symbol}, which is not a {kind}: are --inputs and --outputs swapped? "
                    f"If not, give --{option}-scale, the factor from its numbers to {BASE[kind]}",
                )
            )
    return mistakes, factors


def _refuse_other_time(path: str | Path, rate_hz: float, wanted: Sequence[str]) -> None:
    """Refuse a rate that the file's own time column contradicts, and gaps that only that column shows."""
    time = named_time(path)
    if time is None or time.names[0] in wanted:
        return
    name, time_s = time.names[0], time.values[0]
    step = float(np.median(np.diff(time_s)))
    units = (1.0, 1e3, 1e6, rate_hz)  # s, ms, us, or samples that are counted
    if step > 0.0 and all(abs(step * rate_hz / unit - 1.0) > OTHER_RATE for unit in units):
        unit = unit_in(time.units[0])
        seconds = step * (unit.factor if unit and unit.kind == "time" else 1.0)
        raise InputError(
            str(path),
            f"the given rate is {rate_hz:g} Hz, but the column {name} has steps of {step:.6g}, which "
            f"is {1.0 / seconds:.6g} Hz; give --time {name} instead of --rate, or the right rate",
        )
    refuse(str(path), hidden_gaps(name, time_s, time.rows))


def _sample_time_of(columns: Columns) -> tuple[list[Mistake], float]:
    """Mistakes of the time column, which is the last one, and the sample time."""
    name, time_s = columns.names[-1], columns.values[-1]
    if len(time_s) < 2 or not np.isfinite(time_s).all():
        return [], 1.0  # told already, as too short or as gaps
    unit = unit_in(columns.units[-1])
    if unit is not None and unit.kind == "time" and unit.factor != 1.0:
        time_s = np.round(unit.factor * time_s, 15)  # 0.05 ms in s, without the last digit's noise
    mistakes = time_mistakes(name, time_s, columns.rows)
    if mistakes:
        return mistakes, 1.0
    step = sample_time(time_s)
    if not RATE_HZ.holds(1.0 / step):
        what = f"has steps of {interval(step)}, which is a rate of {1.0 / step:.6g} Hz; it "
        what += f"{RATE_HZ.words()}. Is its unit another than its name says?"
        return [Mistake(where(name), what)], 1.0
    return [], step


def _checked(records: Sequence[Record], all_driven: bool) -> tuple[Record, ...]:
    """An axis may rest in one experiment, but not in all of them; nor may its unit be impossible."""
    if not all_driven:
        return tuple(records)
    source = records[0].source if len(records) == 1 else f"{len(records)} records"
    groups = (
        ("input", records[0].inputs, [record.u_v for record in records]),
        ("output", records[0].outputs, [record.y_um for record in records]),
    )
    mistakes = []
    for kind, names, values in groups:
        for k, name in enumerate(names):
            if not any(moves(value[k]) for value in values):
                mistakes.append(still_mistake(where(name), values[0][k], kind))
            elif wrong := unit_mistake(where(name), max(float(np.ptp(value[k])) for value in values), kind):
                mistakes.append(wrong)
    refuse(source, mistakes)
    return tuple(records)


def read_paired_records(
    u_file: PathLike,
    y_file: PathLike,
    *,
    axes: Sequence[str] = ("sample", "channel"),
    rate_hz: float,
    input_scale: float = 1.0,
    output_scale: float = 1.0,
    variables: tuple[str | None, str | None] = (None, None),
    all_driven: bool = True,
) -> tuple[Record, ...]:
    """Read records from two files of arrays, voltages and displacements: ``.npy``, ``.npz`` or ``.mat``.

    One record for every experiment (realisation, repetition, column of nested loops); the periods of a
    periodic experiment follow each other in time, and the record keeps their length.

    Parameters
    ----------
    u_file, y_file : files with the voltages and the displacements; same axes, channels may differ in number
    axes : meaning of each array axis: ``sample``, ``channel``, ``experiment`` or ``period``;
        ``("sample", "channel", "experiment", "period")`` reads an array of four axes,
        ``("sample", "experiment")`` reads one loop from each column
    rate_hz : samples a second [Hz]
    input_scale, output_scale : factors that turn the files' numbers into V and um
    variables : names of the two variables, if a file holds more than one
    all_driven : whether every input must be driven in some record, as identification needs it

    Raises
    ------
    InputError : every mistake of every experiment at once
    """
    if set(axes) - set(AXES) or len(set(axes)) != len(axes) or "sample" not in axes:
        what = f"are {', '.join(axes)}; name sample, and each of {', '.join(AXES[1:])} once"
        raise InputError("axes", what)
    chosen = {"inputs": ["u"], "outputs": ["y"], "time": []}
    _refuse_arguments([u_file], chosen, rate_hz, (input_scale, output_scale))
    u = _by_experiment(read_array(u_file, variables[0]), axes, str(u_file))
    y = _by_experiment(read_array(y_file, variables[1]), axes, str(y_file))
    source = f"{u_file} and {Path(y_file).name}"
    if (len(u), *u.shape[2:]) != (len(y), *y.shape[2:]):
        raise InputError(source, f"have arrays of different sizes: {_sizes(u)} and {_sizes(y)}")
    period = u.shape[3] if "period" in axes else None

    def experiment(k: int) -> Record:
        return Record(
            input_scale * u[k].reshape(u.shape[1], -1),
            output_scale * y[k].reshape(y.shape[1], -1),
            1.0 / rate_hz,
            source=source if len(u) == 1 else f"{source}, experiment {k + 1}",
            period_samples=period,
        )

    return _checked(all_of(experiment, range(len(u)), "records"), all_driven)


def _by_experiment(array: Array, axes: Sequence[str], source: str) -> Array:
    """(experiment, channel, period, sample), with axes of length 1 for those that the file has not."""
    if array.ndim != len(axes):
        raise InputError(source, f"holds an array of shape {array.shape}, but the axes are {', '.join(axes)}")
    order = ("experiment", "channel", "period", "sample")
    present = [axes.index(axis) for axis in order if axis in axes]
    missing = tuple(k for k, axis in enumerate(order) if axis not in axes)
    return np.expand_dims(array.transpose(present), missing)


def _sizes(array: Array) -> str:
    experiments, _, periods, samples = array.shape
    return f"{experiments} experiments, {periods} periods, {samples} samples"


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
    (Record('time response': 300 samples of 1 ms; u[0] -1 to 0.9999 V; y[0] -4.641 to 4.654 um),)
    """
    from hammerstein.blocks.block_system import traces_of

    fed = tuple(inputs if inputs is not None else data.input_labels or ())
    read = tuple(outputs if outputs is not None else data.output_labels or ())
    traces = list(traces_of(data, fed, read))
    records = []
    for number, (time_s, u, y) in enumerate(traces, start=1):
        source = "time response" if len(traces) == 1 else f"time response, trace {number}"
        refuse(source, time_mistakes("time", time_s, np.arange(1, len(time_s) + 1)))
        records.append(Record(u, y, sample_time(time_s), fed, read, source))
    return tuple(records)
