"""Initial state of a record: rest, a repetition of the record, or unknown."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
from hammerstein.identification.options import InitialStateMode
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record, driven_inputs, moves_while_held, run_in
from hammerstein.records.turning_points import noise_rms

Predict = Callable[[Record, InitialState], Array]
"""Readings (output, sample) that a model predicts for a record [um]."""
FitWith = Callable[[Sequence[InitialState]], Predict]
"""A model fitted to records with given initial states."""
CLOSED_V = 0.01  # part of the range of the voltage
CLOSED_UM = 0.02
"""Parts of the range by which the ends of a closed record may differ."""
KEPT_SHARE = 0.5
"""Part of a record that must remain for the rest to be spent on forgetting."""
CAUTION = 0.25
"""Part of the remaining record that is also excluded until the dynamics are known."""
FASTER = 1.2
"""Ratio of the power of a motion's differences from which one part of a record counts as faster."""
SAME_SWING = 1e-3
"""Part of a swing that may be missing."""
FEWEST = 500
"""Samples of a record that are always kept."""
WORTH = 0.02
"""Part by which another past must lower the squared error."""
TURN_WORTH = 0.1
"""The same for a voltage at which an input may have turned: one is chosen of many."""
TURNS, TURN_ROUNDS, START_ROUNDS = 21, 2, 4
"""Voltages tried at which an input may have turned last, and how often the search goes round."""
DECAYS = (0.1, 0.3, 1.0)  # time constants, in parts of a record, that are looked for in what is left
PARTS_LEFT = (0.05, 0.5, 0.95)
"""Parts of a step's creep still to come for which a record is tried: the error is a parabola of the part."""
ENDS = ("low", "high")
"""Of the range, from which a record may have stepped while that still creeps."""
KINDS = ("rest", "virgin", "stepped", "low", "high")
"""What may have gone before a record."""
SAME_PLACE = 5.0
"""Distance of two first readings, in parts of their noise, that is no other position."""
ALIKE = 2.0  # error of the beginning, in parts of that of the rest
ALIKE_FLOOR = 0.002
"""A start from rest is accepted if its error at the beginning is close to that of the remaining record."""


def cautious_start(record: Record) -> InitialState:
    """Start that is safe before anything is known: periodic records as such, others without their beginning.

    Examples
    --------
    >>> u = np.sin(2.0 * np.pi * np.arange(400) / 100)
    >>> cautious_start(Record([u], [5.0 * u], 1e-3))
    InitialState(kind='repeated', first=151, turn_v=(), held=0)
    """
    if record.period_samples is not None or closed(record):
        return InitialState("repeated")
    first = run_in(record)
    if first > KEPT_SHARE * record.samples:
        return InitialState("rest")
    return InitialState("repeated", first + round(CAUTION * (record.samples - first)))


def closed(record: Record) -> bool:
    """Whether a record ends where it began, at a tip of the voltage, so that it can be repeated."""
    u, y = record.u_v[list(driven_inputs(record))], record.y_um
    span_v, span_um = np.ptp(u, axis=1), np.maximum(np.ptp(y, axis=1), np.finfo(float).tiny)
    gap_v, gap_um = np.abs(u[:, -1] - u[:, 0]) / span_v, np.abs(y[:, -1] - y[:, 0]) / span_um
    to_tip = np.minimum(u.max(axis=1) - u[:, 0], u[:, 0] - u.min(axis=1)) / span_v
    return bool((gap_v < CLOSED_V).all() and (gap_um < CLOSED_UM).all() and (to_tip < CLOSED_V).all())


def judged_starts(
    records: Sequence[Record],
    predict: Predict,
    settle_s: float,
    mode: InitialStateMode = "auto",
    simpler: Sequence[Predict] = (),
    slow_s: float = 0.0,
) -> tuple[InitialState, ...]:
    """Initial state of each record with the least error of a given model.

    A beginning that no initial state explains is excluded. It stays if one of the ``simpler`` models explains
    it as well as the model explains the rest: then the model is wrong there, and the record takes the initial
    state of the model with the least error.

    Parameters
    ----------
    records : voltages and displacements
    predict : readings (output, sample) of the model to a record [um]
    settle_s : settling time of the dynamics [s]
    mode : ``auto``; ``rest`` or ``repeated`` if it is known
    simpler : predictions of other models, which are judged on the same samples
    slow_s : time constant of the model's creep, which may have been under way [s]; 0: no creep
    """
    if mode == "rest":
        return (InitialState("rest"),) * len(records)
    return tuple(_judged(record, predict, settle_s, mode, simpler, slow_s) for record in records)


def own_start(record: Record, start: InitialState, predict: Predict, slow_s: float = 0.0) -> InitialState:
    """Initial state of a record for one model, on the samples that count for all models.

    start : as another model explains the record best; predict : readings that the model predicts
    slow_s : as for ``judged_starts``
    """
    if record.period_samples is not None or (start.kind == "repeated" and closed(record)):
        return start
    choices = dict.fromkeys([start, *(replace(_of_kind(kind, record), first=start.first) for kind in KINDS)])
    left = partial(_left, record, predict, first=start.first)
    errors = {choice: left(choice) for choice in choices}
    if slow_s:
        creeping, error = _creeping(record, left, slow_s, start.first)
        errors[creeping] = error
    best = min(errors, key=lambda choice: errors[choice])
    return best if errors[best] < (1.0 - WORTH) * errors[start] else start


def _judged(
    record: Record,
    predict: Predict,
    settle_s: float,
    mode: InitialStateMode,
    simpler: Sequence[Predict],
    slow_s: float,
) -> InitialState:
    """Initial state with the least error; it excludes the beginning of the record if none explains it."""
    cautious = cautious_start(record)
    if record.period_samples is not None or (mode == "repeated" and closed(record)):
        return cautious
    begun = run_in(record)
    ring = min(round(settle_s / record.sample_time_s), max(cautious.first - begun, 0))
    forgotten = cautious if cautious == InitialState("repeated") else InitialState("repeated", begun + ring)
    short = forgotten.first > KEPT_SHARE * record.samples
    if mode == "repeated":
        return cautious if short else forgotten
    best = _least(record, predict, slow_s)
    before, after = _around(record.y_um - predict(record, best), begun, forgotten.first)
    allowed = ALIKE * after + ALIKE_FLOOR * np.ptp(record.y_um, axis=1)
    if short or bool((before <= allowed).all()):
        return best
    told = [(predict, best)]
    for other in simpler:
        start = _least(record, other)
        before, _ = _around(record.y_um - other(record, start), begun, forgotten.first)
        if (before <= allowed).all():
            told.append((other, start))
    if len(told) > 1:
        return min(told, key=lambda one: _left(record, *one))[1]
    return forgotten


def _around(error: Array, begun: int, first: int) -> tuple[Array, Array]:
    """Rms error (output,) of the beginning of a record and of what follows, about the mean of the latter."""
    about = error - error[:, first:].mean(axis=1, keepdims=True)
    return (
        np.sqrt(np.mean(about[:, : max(begun, 1)] ** 2, axis=1)),
        np.sqrt(np.mean(about[:, first:] ** 2, axis=1)),
    )


def _least(record: Record, predict: Predict, slow_s: float = 0.0) -> InitialState:
    """Of all that may have gone before, what leaves the least error; a simpler past is preferred."""
    left = partial(_left, record, predict)
    order = ("stepped", "rest", "virgin") if moves_while_held(record) else ("rest", "virgin", "stepped")
    choices = [_of_kind(kind, record) for kind in order]
    if closed(record):
        choices.insert(0, InitialState("repeated"))
    errors = [left(start) for start in choices]
    best = next(i for i, error in enumerate(errors) if error <= (1.0 + WORTH) * min(errors))
    least, start = errors[best], choices[best]
    further = [_turned(record, left)] + ([_creeping(record, left, slow_s)] if slow_s else [])
    for other, error in further:
        if error < (1.0 - TURN_WORTH) * least:
            least, start = error, other
    return start


def _left(record: Record, predict: Predict, start: InitialState, first: int = 0) -> float:
    """Mean squared error of a record from some sample on, relative to the ranges of the whole record.

    An output that stands still has no range and does not count.
    """
    span = np.ptp(record.y_um, axis=1)
    error = (record.y_um - predict(record, start))[:, first:] / np.where(span > 0.0, span, np.inf)[:, None]
    return float(np.mean(error.var(axis=1)))


def _turned(record: Record, left: Callable[[InitialState], float]) -> tuple[InitialState, float]:
    """Voltages in the record's range at which the inputs turned last before it, and the error with them."""
    low, high = record.u_v.min(axis=1), record.u_v.max(axis=1)
    middle, driven = 0.5 * (low + high), driven_inputs(record)

    def start(turn: Array) -> InitialState:
        return InitialState("turned", 0, tuple(zip(middle.tolist(), turn.tolist(), strict=True)))

    turn = record.u_v[:, 0].copy()
    least = np.inf
    for _ in range(TURN_ROUNDS if len(driven) > 1 else 1):
        for k in driven:
            trials = [
                np.where(np.arange(len(turn)) == k, v, turn) for v in np.linspace(low[k], high[k], TURNS)
            ]
            errors = [left(start(trial)) for trial in trials]
            best = int(np.argmin(errors))
            if errors[best] < least:
                least, turn = errors[best], trials[best]
    return start(turn), least


def _creeping(
    record: Record, left: Callable[[InitialState], float], slow_s: float, first: int = 0
) -> tuple[InitialState, float]:
    """How long before the record it stepped from an end of its range, while that still creeps; the error.

    What is still to come of the creep, exp(-t / slow_s) after the time t, enters the readings linearly: its
    best part is the lowest point of the parabola through the errors of three.
    """
    time = slow_s / record.sample_time_s

    def start(end: str, part: float) -> InitialState:
        return replace(stepped_from(end, record, round(-time * math.log(part))), first=first)

    tried: dict[InitialState, float] = {}
    for end in ENDS:
        errors = [left(start(end, part)) for part in PARTS_LEFT]
        curved, slope, _ = np.polyfit(PARTS_LEFT, errors, 2)
        part = -0.5 * slope / curved if curved > 0.0 else PARTS_LEFT[int(np.argmin(errors))]
        best = start(end, float(np.clip(part, PARTS_LEFT[0], PARTS_LEFT[-1])))
        tried[best] = left(best)
    return min(tried.items(), key=lambda one: one[1])


def stepped_from(end: str, record: Record, samples: int) -> InitialState:
    """Initial state after a step from an end of the range, a given number of samples before."""
    return InitialState("stepped", 0, _of_kind(end, record).turn_v, max(samples, 1))


def decays(error: Array) -> bool:
    """Whether a decay explains a part of errors (output, sample) that another start is worth.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 500)
    >>> decays(np.exp(-4.0 * t)[None]), decays(np.sin(200.0 * t)[None])
    (True, False)
    """
    t = np.linspace(0.0, 1.0, error.shape[1])
    about = error - error.mean(axis=1, keepdims=True)
    power = np.sum(about**2, axis=1)
    for span in DECAYS:
        decay = np.exp(-t / span)
        decay -= decay.mean()
        explained = (about @ decay) ** 2 / float(decay @ decay)
        if (explained > TURN_WORTH * np.maximum(power, np.finfo(float).tiny)).any():
            return True
    return False


def alike_starts(records: Sequence[Record]) -> dict[str, tuple[InitialState, ...]]:
    """Initial states that all records may share; periodic records are always repeated."""

    def all_of(kind: str) -> tuple[InitialState, ...]:
        return tuple(
            InitialState("repeated") if record.period_samples is not None else _of_kind(kind, record)
            for record in records
        )

    cautious = {"cautious": tuple(cautious_start(record) for record in records)}
    others = {kind: all_of(kind) for kind in KINDS}
    return cautious | others if all(closed(record) for record in records) else others | cautious


def split_state(records: Sequence[Record], starts: Sequence[InitialState]) -> bool:
    """Whether all records begin at one voltage and position, but in different states."""
    if len({replace(start, turn_v=()) for start in starts}) < 2:
        return False
    places = [(record.rest_v + record.u_v[:, 0], record.y_um[:, 0]) for record in records]
    swing_v = np.max([np.ptp(record.u_v, axis=1) for record in records], axis=0)
    noise = np.max([[noise_rms(row) for row in record.y_um] for record in records], axis=0)
    near_um = np.maximum(SAME_PLACE * noise, ALIKE_FLOOR * np.ptp(records[0].y_um, axis=1))
    return all(
        bool((np.abs(v - places[0][0]) <= CLOSED_V * swing_v).all())
        and bool((np.abs(y - places[0][1]) <= near_um).all())
        for v, y in places
    )


def _of_kind(kind: str, record: Record) -> InitialState:
    zero_v = (-record.rest_v).tolist()  # where the amplifier gives none
    if kind == "rest" or (not record.rest_v.any() and kind in ("virgin", "stepped")):
        return InitialState("rest")
    if kind == "virgin" and moves_while_held(record):
        return _of_kind("stepped", record)
    if kind == "virgin":  # driven from 0 V to the first voltage for the first time, and held there
        return InitialState("turned", 0, tuple(zip(zero_v, record.u_v[:, 0].tolist(), strict=True)))
    if kind == "stepped":
        return InitialState("stepped", 0, tuple(zip(zero_v, zero_v, strict=True)))
    low, high = record.u_v.min(axis=1), record.u_v.max(axis=1)
    turn = low if kind == "low" else high
    return InitialState("turned", 0, tuple(zip((0.5 * (low + high)).tolist(), turn.tolist(), strict=True)))


def found_starts(
    records: Sequence[Record],
    fit: FitWith,
    settle_s: float,
    mode: InitialStateMode = "auto",
) -> tuple[InitialState, ...]:
    """Initial state of each record, estimated together with a model.

    A model is fitted for each initial state that all records may have in common. Starting from the best of
    these, each record is judged alone with the model fitted to the states found so far.

    Parameters
    ----------
    records : voltages and displacements
    fit : model fitted with given starts, as the readings that it predicts for a record
    settle_s : settling time of the dynamics [s]
    mode : ``auto``; ``rest`` or ``repeated`` if it is known
    """
    fit = cache(fit)  # one and the same start is asked for again and again
    ways = alike_starts(records)
    if mode != "auto":
        return judged_starts(records, fit(ways["cautious"]), settle_s, mode)
    tried = {starts: _error_of(records, starts, fit) for starts in dict.fromkeys(ways.values())}
    best = next(starts for starts, error in tried.items() if error <= (1.0 + WORTH) * min(tried.values()))
    best = each_alone(records, best, fit, range(len(records)) if len(records) > 1 else ())
    for _ in range(START_ROUNDS):
        found = judged_starts(records, fit(best), settle_s, mode)
        if found == best or math.isinf(_error_of(records, found, fit)):
            break
        best = found
    return best


def each_alone(
    records: Sequence[Record],
    starts: tuple[InitialState, ...],
    fit: FitWith,
    numbers: Sequence[int],
) -> tuple[InitialState, ...]:
    """Change the initial state of one record after the other, if the model fitted then has a smaller error.

    numbers : indices of the records that may change
    """
    if not numbers:
        return starts
    error = _error_of(records, starts, fit)
    for i in numbers:
        record = records[i]
        if record.period_samples is not None:
            continue
        for kind in KINDS:
            other = (*starts[:i], _of_kind(kind, record), *starts[i + 1 :])
            if other == starts:
                continue
            left = _error_of(records, other, fit)
            if left < (1.0 - TURN_WORTH) * error:
                starts, error = other, left
    return starts


def unexplained(records: Sequence[Record], starts: Sequence[InitialState]) -> list[int]:
    """Records whose beginning is excluded because no initial state explains it."""
    return [
        i
        for i, (record, start) in enumerate(zip(records, starts, strict=True))
        if start.kind == "repeated" and record.period_samples is None and not closed(record)
    ]


def _error_of(records: Sequence[Record], starts: tuple[InitialState, ...], fit: FitWith) -> float:
    """Mean squared error of whole records with these initial states; infinite where no model can be fitted.

    With an assumed initial state, the plays of two inputs may never move, so that the records seem not to
    separate the inputs. If this holds for every initial state, the fit to the best one reports it.
    """
    try:
        predict = fit(starts)
    except IdentificationError:
        return math.inf
    return whole_error(records, starts, predict)


def whole_error(records: Sequence[Record], starts: Sequence[InitialState], predict: Predict) -> float:
    """Mean squared error of whole records in parts of their ranges, excluded beginnings included."""
    parts = [_left(record, predict, start) for record, start in zip(records, starts, strict=True)]
    return float(np.mean(parts))


def shortened(
    records: Sequence[Record], starts: Sequence[InitialState], samples: int
) -> tuple[tuple[Record, ...], tuple[InitialState, ...]]:
    """Beginnings of the records with a given total number of samples, for quick searches.

    Longer ones of the records that show how far each input swings: a threshold that is engaged in the whole
    records is engaged in these as well.
    """
    most = max(samples // len(records), FEWEST)
    if all(record.samples <= most for record in records):
        return tuple(records), tuple(starts)
    lengths = np.maximum(most, _swung(records)).tolist()
    pairs = [_cut(*each) for each in zip(records, starts, lengths, strict=True)]
    return tuple(record for record, _ in pairs), tuple(start for _, start in pairs)


def _swung(records: Sequence[Record]) -> Array:
    """Samples of each record (record,) after which one of them has shown the whole swing of each input."""
    needed = np.zeros(len(records), dtype=int)
    for k in range(len(records[0].u_v)):
        swings = [
            np.maximum.accumulate(record.u_v[k]) - np.minimum.accumulate(record.u_v[k]) for record in records
        ]
        whole = (1.0 - SAME_SWING) * max(swing[-1] for swing in swings)
        until, first = min(
            (int(np.argmax(x >= whole)) + 1, i) for i, x in enumerate(swings) if x[-1] >= whole
        )
        needed[first] = max(needed[first], until)
    return needed


def most_dynamic_segment(
    records: Sequence[Record], starts: Sequence[InitialState], samples: int
) -> tuple[tuple[Record, ...], tuple[InitialState, ...]]:
    """Parts of the records, with a given total number of samples, with most of the dynamics.

    This is the part of each record in which the outputs move fastest, if it is clearly faster than the
    beginning: slow cycles do not show a resonance that a later multisine excites.
    """
    most = max(samples // len(records), FEWEST)
    pairs = [
        _cut(record, start, most, _most_dynamic(record, most))
        for record, start in zip(records, starts, strict=True)
    ]
    return tuple(record for record, _ in pairs), tuple(start for _, start in pairs)


def _most_dynamic(record: Record, most: int) -> int:
    """First of so many samples in which the outputs move fastest."""
    if record.samples <= most or record.period_samples is not None:
        return 0
    y = record.y_um
    steps = np.sum(np.diff(y, axis=1, prepend=y[:, :1]) ** 2, axis=0)
    until = np.concatenate([[0.0], np.cumsum(steps)])
    power = until[most:] - until[:-most]
    fastest = int(np.argmax(power))
    return fastest if power[fastest] > FASTER * power[0] else 0


def _cut(record: Record, start: InitialState, most: int, first: int = 0) -> tuple[Record, InitialState]:
    """So many samples of a record from a given one on; a later part begins as if it were repeated.

    So does one that would be over before anything in it counts.
    """
    if record.samples <= most:
        return record, start
    part = record.part(first, first + most)
    if not first and start.kind != "repeated" and start.first <= most // 2:
        return part, start
    return part, InitialState("repeated", min(run_in(part), most // 2))
