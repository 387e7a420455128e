"""One settled period of a periodic path, for an amplifier that repeats it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from hammerstein.arrays import Array, Complex
from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators import Compensator
from hammerstein.compensators.attempt import (
    Missed,
    compensator_of,
    drive_within,
    model_statement,
    sensorless_law,
    stated_error_um,
)
from hammerstein.compensators.drive_file import Terms, alternating, verdict_statements
from hammerstein.compensators.path_file import (
    CYCLE_COST,
    UNWATCHED,
    Onlooker,
    drive_csv,
    predicted_groups,
    read_path,
)
from hammerstein.compensators.reach import Reach as Reach, reach  # a type of what a missed period inherits
from hammerstein.dynamics import linearised, on_grid
from hammerstein.errors import HammersteinError, SimulationError
from hammerstein.metrics import rms
from hammerstein.model import HammersteinModel
from hammerstein.quantities import length
from hammerstein.signals import smooth_step

TRIED_PERIODS = (4, 8, 16, 32)  # periods after which a drive may have settled
SHORTEST_TRY_S = 0.1
"""Short periods are repeated for at least this time, so that a law with dynamics settles."""
RUN_UP_S = 0.25
"""Shortest growth of the amplitude of a run-up, in whole periods."""
SETTLED = 1e-6  # of the range: what two periods may differ by
PLAYED_PERIODS = 10
"""Number of the period with the settled error: hysteresis settles in one, resonances of Q = 100 in ten."""
OPEN = 3.0
"""Step from the last to the first row of a period over its largest other step, from which it is open."""
CENTRING_ROUNDS = 20
"""Largest number of steps to centre a drive; each moves it or halves the step."""
TABLE_UNIT = "table"
"""Unit in the names of columns whose numbers are not volts."""
HELD = "the range limits the drive in {} of {} samples of a settled period, with {} (--range)"


@dataclass(frozen=True, eq=False)
class Cycle:
    """One period of voltages, and the model's response when it is repeated.

    reference_um : (p, N) path, relative to the start; drive_v : (m, N) as sent
    played_um : (p, N) position in the last of ten periods; closure_um : its change from the period before
    run_up_v : (m, K) voltages from the start to the period, sent once before it
    first_um : (p, N) position in the first period after the run-up
    learnt : whether a trial has corrected the drive; the model then no longer follows the path
    """

    model: HammersteinModel
    limits: DriveRange
    sample_time_s: float
    reference_um: Array
    drive_v: Array
    played_um: Array
    closure_um: float
    source: str
    statement: str
    run_up_v: Array
    first_um: Array
    learnt: bool = False

    @property
    def period_s(self) -> float:
        """Length of a period [s]."""
        return float(self.drive_v.shape[1] * self.sample_time_s)

    @property
    def aim_um(self) -> Array:
        """Target of the points of a table (p, N) [um]: the path, or the response to a learnt drive.

        With the path as target, the model would undo the corrections of a trial.
        """
        return self.played_um if self.learnt else self.reference_um

    @property
    def error_um(self) -> Array:
        """Position minus ``aim_um`` (p, N) in a settled period [um]."""
        return self.played_um - self.aim_um

    def largest_steps_v(self) -> tuple[float, float]:
        """Largest step between samples [V]: of run-up and period, and of the period alone from the start."""
        start = self.limits.start_v[:, None]
        sent = np.concatenate([start, self.run_up_v, self.drive_v, self.drive_v[:, :1]], axis=1)
        return float(np.abs(np.diff(sent, axis=1)).max()), float(np.abs(self.drive_v[:, :1] - start).max())

    def statements(self) -> list[str]:
        """Conditions for sending the period."""
        settled, first = (_worst(self, position) for position in (self.played_um, self.first_um))
        step, jump = self.largest_steps_v()
        seconds = self.run_up_v.shape[1] * self.sample_time_s
        start = ", ".join(f"{value:g}" for value in self.limits.start_v)
        rings = alternating(self.model, np.tile(self.drive_v, (1, 2)), self.limits)
        nominal = (
            f"Error if the actuator equals the model: settled (period {PLAYED_PERIODS}) {settled}; "
            f"first period after the run-up, with ringing, {first}. {model_statement(self.model)}"
        )
        said = [
            f"Model {self.source} ({self.model.origin}). One settled period of {self.period_s:.6g} s "
            "to repeat: after the last row, the first row follows.",
            *verdict_statements(self.model),
            *([f"{rings} Lower --filter-hz."] if rings else []),
            f"Run-up of {seconds:.6g} s from {start} V to the period; send it "
            f"once. Largest step {step:.3g} V; without the run-up the first step is {jump:.3g} V.",
            *([] if self.learnt else [nominal]),
            f"The settled position repeats within {length(max(self.closure_um, 1e-5), 2)} um.",
        ]
        return [*said, self.statement] if self.statement else said

    def run_up_csv(self, factor: float = 1.0, offset: float = 0.0) -> str:
        """Text of the run-up file; its times end where the period begins.

        factor, offset : from volts to the numbers of a table
        """
        time_s = np.arange(-self.run_up_v.shape[1], 0, dtype=np.float64) * self.sample_time_s
        unit = number_unit(factor, offset)
        numbers = f"Number = {factor:g} x V + {offset:g}" if unit == TABLE_UNIT else "Absolute voltages in V"
        said = [f"Run-up: send it once, then repeat the period. {numbers}.", *self.statements()]
        return drive_csv(time_s, (("drive", unit, self.model.inputs, factor * self.run_up_v + offset),), said)

    def to_csv(self) -> str:
        """Text of the drive file: one period."""
        time_s = np.arange(self.drive_v.shape[1], dtype=np.float64) * self.sample_time_s
        groups = predicted_groups(self.model, self.drive_v, self.reference_um, self.played_um)
        return drive_csv(time_s, groups, ["Voltages of one period: absolute, in V.", *self.statements()])


def number_unit(factor: float, offset: float) -> str:
    """Unit in the names of columns of numbers, factor x V + offset."""
    return "v" if (factor, offset) == (1.0, 0.0) else TABLE_UNIT


def _worst(cycle: Cycle, position_um: Array) -> str:
    """Error of a period for each output."""
    return ", ".join(
        f"{name} {length(rms(row))} um rms, {length(np.abs(row).max())} um at most"
        for name, row in zip(cycle.model.outputs, position_um - cycle.reference_um, strict=True)
    )


def run_up(drive_v: Array, start_v: Array, sample_time_s: float) -> Array:
    """Voltages (m, K) from the start at rest to the first sample of a period (m, N).

    Whole periods whose distance from the start grows from 0 to 1 by a fifth-order step, then one at full
    amplitude, after which every play that the period moves has forgotten the start. All voltages lie between
    the start and the period, so no play goes further than the period itself moves it.

    Examples
    --------
    >>> way = run_up(np.full((1, 100), 8.0), np.zeros(1), 1e-3)
    >>> way.shape, way[0, [0, 150, 300]].round(3).tolist()
    ((1, 400), [0.0, 4.0, 8.0])
    """
    samples = drive_v.shape[1]
    growing = math.ceil(RUN_UP_S / (samples * sample_time_s))
    share = smooth_step(np.arange(growing * samples) / (growing * samples))
    grown = start_v[:, None] + share * (np.tile(drive_v, (1, growing)) - start_v[:, None])
    return np.concatenate([grown, drive_v], axis=1)


@dataclass(frozen=True, eq=False)
class Design:
    """A law for a periodic path: model, range, law, one period (p, N) [um], and names of the files."""

    model: HammersteinModel
    limits: DriveRange
    compensator: Compensator
    law: Law[Any]
    reference_um: Array
    source: str
    path: str
    resampled: str

    def of_law(self, terms: Terms) -> Cycle:
        """One settled period of the law.

        Raises SimulationError if the range causes an error above that of the model.
        """
        asked, at_range = centred(self.law, self.model, self.reference_um)
        cycle = self.cycle(asked, terms, at_range)
        missed, own = np.abs(cycle.error_um).max(axis=1), stated_error_um(self.model)
        if at_range and not terms.clip and not (own is not None and (missed <= own).all()):
            reachable = reach(self.model, self.limits, run_anyway=True)
            least = np.zeros(len(missed)) if own is None else own
            given = (self.model, self.limits, self.compensator, self.reference_um, least, reachable)
            told = MissedPeriod(*given, terms.offset_um, cycle, at_range).statement()
            raise SimulationError(f"{self.path}: out of reach: {told}")
        return cycle

    def of_trial(self, drive_v: Array, terms: Terms) -> Cycle:
        """The period that a trial has corrected; SimulationError for voltages at the range."""
        at_range = int(self.limits.reached(drive_v).any(axis=0).sum())
        if at_range and not terms.clip:
            hit = HELD.format(at_range, drive_v.shape[1], self.limits.words(self.model.inputs))
            raise SimulationError(f"{self.path}: out of reach: {hit}. Accept it with --clip.")
        return replace(self.cycle(drive_v, terms, at_range), learnt=True)

    def cycle(self, asked_v: Array, terms: Terms, at_range: int = 0) -> Cycle:
        """One period of these voltages on the steps of the converter.

        at_range : samples in which a law wanted more than the range

        Raises SimulationError for voltages beyond the records.
        """
        model, limits = self.model, self.limits
        converter, time_s = drive_within(model, limits), model.instruments.drive.sample_time_s
        sent, _ = converter.apply(asked_v)
        terms.refuse_beyond(model, sent)
        player = Player(model, limits)
        position, closure = player.settled(sent)
        way, _ = converter.apply(run_up(sent, limits.start_v, time_s))
        first = player.position(np.concatenate([way, sent], axis=1))[:, way.shape[1] :]
        said = f"{self.resampled} {self.law.statement()}".strip()
        if at_range:
            hit = HELD.format(at_range, sent.shape[1], limits.words(model.inputs))
            said = f"{hit[0].upper()}{hit[1:]}. {said}"
        return Cycle(
            model, limits, time_s, self.reference_um, sent, position, closure, self.source, said, way, first
        )


def design_of(
    model_path: str,
    path: Path,
    law: str,
    options: Mapping[str, Any],
    terms: Terms,
    onlooker: Onlooker = UNWATCHED,
) -> Design:
    """Design a law for a file with one period of a path; raises the errors of ``cycle_of``."""
    model, source = terms.loaded(model_path), PurePath(model_path).name
    terms.refuse_flagged(model, source)
    limits = terms.allowed_range(model)
    time_s = model.instruments.drive.sample_time_s
    _, path_um, found = read_path(
        path, model, time_s, cost=CYCLE_COST, onlooker=onlooker, units=terms.units, periodic=True
    )
    onlooker.tell("computing the period")
    compensator, path_um = compensator_of(law, options), terms.moved(path_um)
    built = sensorless_law(compensator, model, limits, time_s)
    return Design(model, limits, compensator, built, path_um, source, str(path), found)


def cycle_of(
    model_path: str,
    path: Path,
    law: str,
    options: Mapping[str, Any],
    terms: Terms | None = None,
    onlooker: Onlooker = UNWATCHED,
) -> Cycle:
    """One settled period of voltages for a file with one period of a path.

    After the last row of the file its first one follows: a period of N samples has N rows.

    Raises
    ------
    InputError : a file or an option is wrong
    SimulationError : the law cannot work, the periods do not become alike, or the path is out of reach or
        does not fit the memory
    IdentificationError : the model's own fit report flagged it
    """
    terms = terms or Terms()
    return design_of(model_path, path, law, options, terms, onlooker).of_law(terms)


@dataclass(frozen=True, eq=False)
class MissedPeriod(Missed):
    """Periodic path out of reach of a settled drive."""

    found: Cycle
    at_range: int

    @property
    def clipped_um(self) -> float:
        """Largest error with ``--clip`` [um]."""
        return float(np.abs(self.found.error_um).max())

    def _limits_hit(self) -> str:
        hit = HELD.format(self.at_range, self.path_um.shape[1], self.limits.words(self.model.inputs))
        missed = zip(self.model.outputs, np.abs(self.found.error_um).max(axis=1).tolist(), strict=True)
        told = ", ".join(f"{length(um, 2)} um on {name}" for name, um in missed)
        return f"{hit}; the error is up to {told}{self._gap()}."

    def _gap(self) -> str:
        """Name the jump of a period whose first row does not follow the last one."""
        jumps = np.abs(self.path_um[:, 0] - self.path_um[:, -1])
        worst = int(np.argmax(jumps))
        if not (jumps > OPEN * np.abs(np.diff(self.path_um, axis=1)).max(axis=1))[worst]:
            return ""
        name = self.model.outputs[worst]
        return f"; the period does not close, {name} jumps by {jumps[worst]:.3g} um: give one whole period"

    def _attempt(self, compensator: Compensator, path_um: Array) -> tuple[float, bool]:
        try:
            law = sensorless_law(compensator, self.model, self.limits, self.found.sample_time_s)
            drive, at_range = centred(law, self.model, path_um)
        except HammersteinError:
            return np.inf, False
        settled_um, _ = Player(self.model, self.limits).settled(drive)
        error = np.abs(settled_um - path_um).max(axis=1)
        return float(error.max()), not at_range or bool((error <= self.own_um).all())


def settled(law: Law[Any], model: HammersteinModel, reference_um: Array) -> Array:
    """Drive (m, N) of the settled period: the fixed point of the loop.

    Raises SimulationError where the periods do not become alike.
    """
    samples = reference_um.shape[1]
    ends = -(-law.start_samples // samples)
    turns = math.ceil(SHORTEST_TRY_S / (samples * model.instruments.drive.sample_time_s))
    change = np.inf
    for periods in (turns * tried for tried in TRIED_PERIODS):
        drive = law.drive_for(np.tile(reference_um, (1, periods + ends)))
        one, next_one = (drive[:, (periods - n) * samples :][:, :samples] for n in (1 + turns, 1))
        change = float(np.abs(next_one - one).max())
        left = law.leaves * float(np.ptp(next_one, axis=1).max())
        if change <= SETTLED * float(law.range.span_v.max()) + left:
            return next_one.copy()
    raise SimulationError(
        f"The drive still changes by {change:.3g} V from one period to the next after "
        f"{turns * TRIED_PERIODS[-1]} periods. "
        + (
            "Creep in the model causes this: use a model without creep for a table."
            if any(getattr(axis, "creep", ()) for axis in getattr(model.dynamics, "axes", ()))
            else "Use a law without dynamics, such as exact_inverse, or a longer period."
        )
    )


def centred(law: Law[Any], model: HammersteinModel, reference_um: Array) -> tuple[Array, int]:
    """Settled drive (m, N) whose repetition from the start follows the path, and its samples at the range.

    Plays that a loop does not move in both directions keep a state that depends on how the loop began. A
    table begins differently from the law, so that its loop has another centre and the same shape. The
    voltages are therefore shifted until the centre is that of the path.
    """
    limits, player = law.range, Player(model, law.range)
    drive, share = settled(law, model, reference_um), 1.0
    clipped = limits.reached(drive).any(axis=0)
    turn = np.linalg.pinv(model.gain(half_stroke(drive)))
    off = (player.settled(drive)[0] - reference_um).mean(axis=1, keepdims=True)
    for _ in range(CENTRING_ROUNDS):
        trial = np.clip(drive - share * (turn @ off), limits.low_v[:, None], limits.high_v[:, None])
        left = (player.settled(trial)[0] - reference_um).mean(axis=1, keepdims=True)
        if np.abs(left).max() < np.abs(off).max():
            drive, off = trial, left
        else:
            share *= 0.5
    return drive, int((clipped | limits.reached(drive).any(axis=0)).sum())


def half_stroke(drive_v: Array) -> float:
    """Half of the largest swing of an input [V], at which the gain of the settled loops is evaluated."""
    return max(0.5 * float(np.ptp(drive_v, axis=1).max()), 1e-6)


class Player:
    """Simulates voltages (m, N) from the start, on the sample time of the model's drive."""

    def __init__(self, model: HammersteinModel, limits: DriveRange):
        self._start_v, self._time_s = limits.start_v, model.instruments.drive.sample_time_s
        self._model, self._block = model.on_grid(self._time_s), on_grid(model.dynamics, self._time_s)
        self._before_um, self._memory = self._model.hysteresis.standing(limits.history())

    def position(self, drive_v: Array) -> Array:
        """Position (p, N) relative to the start [um]."""
        v, _ = self._model.static_response(drive_v, self._memory)
        return self._block.respond(v - self._before_um[:, None])[0]

    def settled(self, drive_v: Array) -> tuple[Array, float]:
        """Position (p, N) in the last of ten periods (m, N), and its change from the period before [um].

        The run-up comes before them: a jump from the start would still ring after ten short periods.
        """
        samples = drive_v.shape[1]
        way = run_up(drive_v, self._start_v, self._time_s)
        position = self.position(np.concatenate([way, np.tile(drive_v, (1, PLAYED_PERIODS))], axis=1))
        last, one_before = position[:, -samples:], position[:, -2 * samples : -samples]
        return last.copy(), float(np.abs(last - one_before).max())


def held_least(cycle: Cycle, points: int) -> Array:
    """Voltages (m, points), each held over N / points samples, with the least error in simulation.

    Near any voltages the settled position changes by about ``H d``: the hold, the gain of the settled loops
    and the linear block, all periodic. The least-squares problem of ``error + H d`` separates into one small
    problem for each frequency of the table, in which the images of the hold are summed. A few Gauss-Newton
    steps account for the hysteresis; a step is kept only if it lowers the error.
    """
    hold = cycle.drive_v.shape[1] // points
    table = cycle.drive_v.reshape(len(cycle.drive_v), points, hold).mean(axis=2)
    response = _periodic_response(cycle, hold)
    best: Array = table
    error = held_error(cycle, table, hold)
    low, high = cycle.limits.low_v[:, None], cycle.limits.high_v[:, None]
    for share in (1.0, 1.0, 0.5, 0.5, 0.25):
        trial = np.clip(best - share * _least_change(error, response, points), low, high)
        found = held_error(cycle, trial, hold)
        if rms(found) < rms(error):
            best, error = trial, found
    return best


def held_error(cycle: Cycle, table: Array, hold: int) -> Array:
    """Error (p, N) of a period [um] whose voltages (m, n) are each held over ``hold`` samples."""
    position, _ = Player(cycle.model, cycle.limits).settled(np.repeat(table, hold, axis=1))
    return np.asarray(position - cycle.aim_um)


def _periodic_response(cycle: Cycle, hold: int) -> Complex:
    """Response (frequency, p, m) from a table to the settled position on the fine grid."""
    samples, time_s = cycle.drive_v.shape[1], cycle.sample_time_s
    hysteresis, half = cycle.model.about_middle, half_stroke(cycle.drive_v)
    block = linearised(cycle.model.dynamics, time_s, hysteresis.amplitude(half).sum(axis=1))
    turn = np.arange(samples) / samples
    pulse = np.exp(-2j * np.pi * np.outer(turn, np.arange(hold))).sum(axis=1)
    return np.asarray(block.response(turn / time_s) @ hysteresis.gain(half) * pulse[:, None, None])


def _least_change(error: Array, response: Complex, points: int) -> Array:
    """Change (m, points) of a table whose effect comes nearest to an error (p, N)."""
    spectrum = np.fft.fft(error, axis=1).T[:, :, None]
    images = response.reshape(-1, points, *response.shape[1:])
    asked = spectrum.reshape(-1, points, *spectrum.shape[1:])
    turned = np.conj(np.swapaxes(images, 2, 3))
    square = (turned @ images).sum(axis=0)
    ridge = 1e-6 * float(np.abs(square).max()) * np.eye(square.shape[-1])
    change = np.linalg.solve(square + ridge, (turned @ asked).sum(axis=0))
    return np.array(np.fft.ifft(change[:, :, 0].T, axis=1).real, dtype=np.float64, order="C")
