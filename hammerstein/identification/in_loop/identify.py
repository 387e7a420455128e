"""Identification of a model with hysteresis inside its loop, selected by cross-validation."""

import contextlib
import hashlib
import itertools
import json
import operator
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Annotated, NamedTuple, Self

import numpy as np

from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError, InputError
from hammerstein.files import read_limited, write_atomic
from hammerstein.identification.fit import Fit, Kind
from hammerstein.identification.fit_report import left_out, model_of, offsets, verdict
from hammerstein.identification.identify import from_last_rest, given_records
from hammerstein.identification.in_loop.parameters import (
    LoopParameters,
    SettledPeriod,
    linear_start,
    with_band,
    with_ends,
    with_plays,
    with_products,
)
from hammerstein.identification.in_loop.search import (
    Progress,
    Search,
    Selection,
    from_one_point,
    settled_periods,
    start_of,
    with_period,
)
from hammerstein.identification.linear.frequency_response import measured_response
from hammerstein.identification.linear.state_space import fit_state_space
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.options import FEWEST_EXPERIMENTS, KnownSensor, Order
from hammerstein.identification.residual_analysis import record_flags
from hammerstein.identification.score import Candidate, SensorModel, score
from hammerstein.identification.state_space_candidates import gain_model, state_space
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import half_swing, swing_ends
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Range, number_of
from hammerstein.records.record import Record, driven_inputs
from hammerstein.runtime.resources import one_blas_thread

STATES = (2, 4, 8, 16)
"""States of each output that are tried without given order, until more are not better. Too many states
imitate the amplitude dependence of a resonance, badly, by further modes."""
PATIENCE = 4
"""Consecutive steps without improvement on the selection experiments, after which a search ends."""
GAINED = 0.99
"""Ratio of selection errors above which more paths are not worth their parameters."""
ALIKE = 0.05
"""Relative difference of amplitudes of records that count as equal."""
TENTH = 10
"""A tenth of a record is its beginning, in which a motion from before it rings down."""
IN_MOTION, SEEN_MOTION = 4.0, 0.005
"""Error of the beginning over that after it, and over the range, from which a record does not begin at rest.
A record cut out of the motion of a stack had 11 and 0.04; twelve from rest had up to 1.1 and 0.001."""
EVERY_S = 60.0
"""Interval between partial models that a search writes [s]."""
INVERSE = "compensate finds the voltages of a path in passes, and says whether they converge"
FORMAT = "hammerstein-feedback-search/2"
WHAT = "file of an interrupted search"


class LoopSettings(KnownSensor):
    """Options for the identification of hysteresis in a loop.

    minutes : of search after which the best model found is given; what an interruption lost does not count
    sensor_bandwidth_hz, sensor_delay_s : the readings are freed of this lag and delay first
    """

    order: Order = None
    minutes: Annotated[float, Range(1e-3, 1e6, or_inf=True)] = 60.0

    @property
    def sensor(self) -> SensorModel:
        """Known properties of the sensor."""
        return SensorModel(self.sensor_bandwidth_hz, self.sensor_delay_s)

    def with_sensor(self, known: KnownSensor) -> Self:
        """Return the same with the sensor of other options."""
        return self.changed(**{name: getattr(known, name) for name in KnownSensor.model_fields})


@one_blas_thread()
def identify_in_loop(
    records: Sequence[Record],
    settings: LoopSettings | None = None,
    *,
    validation: Sequence[Record] = (),
    name: str = "identified",
    kept: Path | None = None,
    playable: Path | None = None,
    complete: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[HammersteinModel, Fit]:
    """Identify a model with plays and products inside its loop from the simulated output.

    The search begins with linear dynamics. Plays, plays that move twice in a sample, more plays, more paths
    for the upper and the lower modes, then products of z are tried on two thirds of the experiments. Each is
    kept if it lowers the error on the other third, which also sets the number of steps. Then the chosen
    structure is fitted to all experiments.

    Parameters
    ----------
    records : experiments at several amplitudes, on one sample time
    validation : validation records: reported, never used to choose
    kept : file of the structures tried so far; an interrupted search continues from it, as if it had not been
    playable : file of the best model so far, written at most about once a minute
    complete : whether a search that the time limit ended is an error, as its result depends on the machine

    Raises
    ------
    IdentificationError : too few experiments, or linear dynamics are as good on the selection experiments
    InputError : several sample times, not as many inputs as outputs, or a file of another search
    """
    settings = settings or LoopSettings()
    given = given_records(records), given_records(validation)
    whole, others = (tuple(map(with_period, some)) for some in given)
    begun = partial(from_last_rest, sensor=settings.sensor, accept_order=settings.accept_order)
    prompt = begun(whole), begun(others) if others else ()
    ready, held = (tuple(map(settings.sensor.freed, some)) for some in from_one_point(*prompt))
    _refuse(ready, held)

    def write(found: LoopParameters) -> None:
        if playable is not None:
            with contextlib.suppress(InputError):  # a loop that is not stable cannot be played
                model_so_far(found, ready, name).save(playable)

    with ThreadPoolExecutor(2) as pool:
        work = _Work(settings, kept, ready, progress, write, pool)
        found = work.chosen(ready)
    if complete and work.late:
        raise IdentificationError(
            f"the time limit of {settings.minutes:g} minutes ended the search; raise it, because what was "
            "found by then depends on the machine"
        )
    if not found.chosen.percent < GAINED * found.linear.percent:
        raise IdentificationError(
            f"hysteresis in the loop has an error of {found.chosen.percent:.3g} % of the range on the "
            f"selection experiments, scaled to one size, linear dynamics alone {found.linear.percent:.3g} %: "
            "it does not improve the model. Identify without --hysteresis-in-loop"
        )
    repeated = sum(map(operator.is_not, itertools.chain(*given), (*whole, *others)))
    notes = [*_notes(ready, repeated), *work.notes()]
    return result_of(found, ready, held, name, settings.sensor, notes)


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search: the loop, linear dynamics for comparison, and every structure that was tried."""

    loop: LoopParameters
    block: LinearBlock
    trials: tuple[Trial, ...]

    @property
    def linear(self) -> Trial:
        """Linear dynamics on the selection experiments."""
        return self.trials[0]

    @property
    def chosen(self) -> Trial:
        """The chosen structure on the selection experiments, before all experiments were fitted."""
        return next(trial for trial in self.trials if trial.kept)


class _Best(NamedTuple):
    """A structure at its best, the steps in which it was found, and the seconds of search until its end.

    cut : whether the time limit ended its steps
    """

    found: LoopParameters
    trial: Trial
    steps: int
    seconds: float = 0.0
    cut: bool = False


class _Work:
    """One search: what was asked, when it ends, and what was tried."""

    def __init__(
        self,
        settings: LoopSettings,
        kept: Path | None,
        records: Sequence[Record],
        tell: Callable[[str], None],
        write: Callable[[LoopParameters], None],
        pool: Executor,
    ) -> None:
        self.settings, self.kept, self.tell, self.write, self.pool = settings, kept, tell, write, pool
        self.digest = _digest(records, settings.order)
        self.before = _stages(kept, self.digest) if kept is not None and kept.is_file() else []
        self.begun_s, self.written_s = time.monotonic(), -np.inf
        self.stages: list[_Best] = []
        self.late = False

    def notes(self) -> Iterator[str]:
        """What a reader must know of how the search ended."""
        if self.late:
            limit = f"the time limit of {self.settings.minutes:g} minutes"
            yield f"{limit} ended the search; --minutes gives it more"

    def chosen(self, records: Sequence[Record]) -> Found:
        """Choose structure and steps on a third of the experiments, and fit all of them."""
        self.tell("continuing the interrupted search" if self.before else "fitting linear dynamics")
        blocks = _linear(records, self.settings.order)
        block = next(blocks)
        periods = settled_periods(records, block.respond)
        parts = Selection.of(periods)
        best, straight = None, parts.of_linear(block)
        for one in itertools.chain([block], blocks):
            linear, before = parts.of_linear(one), best
            if linear.percent < straight.percent:
                straight, block = linear, one
            best = self._better_of(before, self._of_order(one, parts))
            if best is before or self._is_late(0.5):
                break
        assert best is not None
        middle = float(np.median(np.abs(np.angle(np.linalg.eigvals(best.found.full())))))
        best = self._grown(
            best,
            parts,
            partial(with_band, low=middle, high=np.pi, periods=parts.seen),
            partial(with_band, low=0.0, high=middle, periods=parts.seen),
            with_products,
        )
        tried = (straight, *(stage.trial for stage in self.stages))
        trials = tuple(replace(trial, kept=trial is best.trial) for trial in tried)
        return Found(self._all(best, periods), block, trials)

    def _of_order(self, block: LinearBlock, parts: Selection) -> _Best:
        """Plays in the loop of linear dynamics of one order.

        Plays that move once leave an error that states beyond the true order explain, so that orders are
        compared with plays that move twice, and enough of them.
        """
        begun = linear_start(block, parts.seen)
        return self._grown(
            self._tried(begun, parts),
            parts,
            lambda found: with_ends(begun),
            lambda found: None if found.H.size else with_ends(found),  # the linear start led elsewhere
            partial(with_plays, periods=parts.seen),
        )

    def _grown(
        self, best: _Best, parts: Selection, *growing: Callable[[LoopParameters], LoopParameters | None]
    ) -> _Best:
        """Search from larger structures, one after the other, while there is time."""
        for grow in growing:
            larger = None if self._is_late(0.5) else grow(best.found)
            if larger is not None:
                best = self._better_of(best, self._tried(larger, parts))
        return best

    def _better_of(self, best: _Best | None, tried: _Best) -> _Best:
        return tried if best is None or tried.trial.percent < GAINED * best.trial.percent else best

    def _tried(self, begun: LoopParameters, parts: Selection) -> _Best:
        """Search until the selection error stops falling, or restore the result of an interrupted search."""
        stage = self._done(begun) or self._searched(begun, parts)
        self.stages.append(stage)
        self._keep()
        return stage

    def _done(self, begun: LoopParameters) -> _Best | None:
        """Next stage of the interrupted search, unless it was cut short and there is more time now."""
        stage = self.before.pop(0) if self.before else None
        more = stage is not None and stage.cut and stage.seconds < 30.0 * self.settings.minutes
        if stage is None or more or stage.trial.name != begun.describe():
            self.before = []
            return None
        self.begun_s = time.monotonic() - stage.seconds
        self.late |= stage.cut
        return stage

    def _searched(self, begun: LoopParameters, parts: Selection) -> _Best:
        least = min((stage.trial.percent for stage in self.stages), default=np.inf)
        tried = _Best(begun, Trial(begun.describe(), len(begun.vector()), np.array([np.inf])), 0)

        def tell(progress: Progress) -> bool:
            nonlocal tried
            now = parts.of_loop(progress.found, self.pool)
            self.tell(f"{now.name}, step {progress.step}: {now.percent:.3g} % on the selection experiments")
            if now.percent < tried.trial.percent:
                tried = _Best(progress.found, now, progress.step + 1)
                if now.percent < least:  # of all orders
                    self._show(progress.found)
            late = self._is_late(0.5)
            tried = tried._replace(cut=late)
            return late or progress.step + 1 - tried.steps >= PATIENCE

        Search().run(begun, parts.seen, self.pool, tell)
        return tried._replace(seconds=time.monotonic() - self.begun_s)

    def _all(self, best: _Best, periods: Sequence[SettledPeriod]) -> LoopParameters:
        """Fit all experiments with the structure chosen, by as many steps."""

        def tell(progress: Progress) -> bool:
            left = float(np.sqrt(np.mean(progress.rms**2)))
            self.tell(f"all experiments, step {progress.step + 1} of {best.steps}: {left:.4g} um")
            self._show(progress.found)
            return progress.step + 1 < best.steps and self._is_late()

        return Search(steps=best.steps).run(best.found, periods, self.pool, tell)

    def _is_late(self, part: float = 1.0) -> bool:
        """Whether the time is over for what would come next, which a note then says."""
        late = time.monotonic() > self.begun_s + part * 60.0 * self.settings.minutes
        self.late |= late
        return late

    def _show(self, found: LoopParameters) -> None:
        """Write the best model so far, now and then."""
        if time.monotonic() - self.written_s >= EVERY_S:
            self.write(found)
            self.written_s = time.monotonic()

    def _keep(self) -> None:
        """Write what an interrupted search goes on from: every stage so far, and those it will come to."""
        if self.kept is not None:
            plain = [
                [one.found.plain(), one.trial.squares.tolist(), one.steps, one.seconds, one.cut]
                for one in (*self.stages, *self.before)
            ]
            write_atomic(self.kept, json.dumps({"format": FORMAT, "of": self.digest, "stages": plain}) + "\n")


def _stages(kept: Path, digest: str) -> list[_Best]:
    """Stages of an interrupted search; InputError for another file."""
    try:
        content = json.loads(read_limited(kept, what=WHAT))
        if (content["format"], content["of"]) != (FORMAT, digest):
            what = "belongs to a search on other records, of another order or of another version"
            raise InputError(str(kept), f"{what}; remove it to start again")
        stages = []
        for plain, squares, steps, seconds, cut in content["stages"]:
            found = LoopParameters.of(plain)
            trial = Trial(found.describe(), len(found.vector()), np.array(squares, float))
            stages.append(_Best(found, trial, int(steps), float(seconds), bool(cut)))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError):
        raise InputError(str(kept), f"is not a {WHAT}; remove it to start again") from None
    return stages


def _refuse(records: Sequence[Record], held: Sequence[Record]) -> None:
    if len(records) < FEWEST_EXPERIMENTS:
        there = f"there {'is' if len(records) == 1 else 'are'} {len(records)}"
        raise IdentificationError(
            f"hysteresis in the loop needs {FEWEST_EXPERIMENTS} experiments, because some select the "
            f"structure; {there}. Record more, at several amplitudes"
        )
    m, p = len(records[0].u_v), len(records[0].y_um)
    if m != p:
        what = f"have {m} inputs and {p} outputs; hysteresis in the loop needs equal numbers"
        raise InputError("records", what)
    if len({record.sample_time_s for record in (*records, *held)}) > 1:
        raise InputError("records", "have several sample times; resample them to the same sample time")


def _notes(records: Sequence[Record], repeated: int) -> Iterator[str]:
    """What a reader must know of the records, of which some were found to repeat."""
    if repeated:
        count = number_of(repeated, "record")
        yield f"taken for settled periods, because voltages and outputs repeat: {count}"
    sizes = [
        [float(record.u_v[k].std()) for record in records if k in driven_inputs(record)]
        for k in range(len(records[0].u_v))
    ]
    if all(min(own) > (1.0 - ALIKE) * max(own) for own in sizes if own):
        yield "all records have one amplitude; several are needed to tell what changes with the amplitude"


def _linear(records: Sequence[Record], order: int | None) -> Iterator[LinearBlock]:
    """State spaces of all experiments, of even orders, each when it is asked for."""
    orders = [order + order % 2] if order else [states * len(records[0].y_um) for states in STATES]
    response = measured_response(records)
    yield fit_state_space(response, orders[0])
    with contextlib.suppress(IdentificationError):  # the records have too few lines for more states
        yield from (fit_state_space(response, one) for one in orders[1:])


def _digest(records: Sequence[Record], order: int | None) -> str:
    """Hash of what a search depends on, its time limit left out: it may go on with more."""
    told = hashlib.sha256(repr(order).encode())
    for record in records:
        told.update(repr((record.sample_time_s, record.period_samples)).encode())
        told.update(record.u_v.tobytes() + record.y_um.tobytes())
    return told.hexdigest()[:16]


def result_of(
    found: Found,
    records: tuple[Record, ...],
    held: tuple[Record, ...],
    name: str,
    sensor: SensorModel,
    notes: Sequence[str] = (),
) -> tuple[HammersteinModel, Fit]:
    """Model and fit report.

    records, held : fitted and validation records, settled periods counted from one voltage
    sensor : of the records, which are freed of it
    notes : on the search
    """
    one, straight = records[0], gain_model(np.eye(len(records[0].u_v)))
    candidates: dict[Kind, Candidate] = {
        "linear_dynamics": Candidate(straight, state_space(found.block)),
        "in_loop": Candidate(straight, found.loop.dynamics(one.sample_time_s)),
    }
    best, starts, held_starts = candidates["in_loop"], *(tuple(map(start_of, own)) for own in (records, held))
    fitted = {kind: score(model, records, starts) for kind, model in candidates.items()}
    judged = {kind: score(model, held, held_starts) for kind, model in candidates.items() if held}
    each = [*records, *held], [*starts, *held_starts]
    flags = (*record_flags(best, *each), *_in_motion(best, *each))
    swing = half_swing(records)
    fit = Fit(
        inputs=one.inputs,
        outputs=one.outputs,
        kind="in_loop",
        fit=fitted,
        validation=judged,
        solver="simulated_output",
        operators=straight.operators,
        amplitude_v=float(swing.max()),
        amplitudes_v=tuple(swing.tolist()),
        voltages=Voltages.of(one.rest_v, *swing_ends(records)),
        sample_time_s=one.sample_time_s,
        sensor_bandwidth_hz=sensor.bandwidth_hz,
        sensor_delay_s=sensor.delay_s,
        offsets_um=offsets(best, records, starts),
        starts=starts,
        held_starts=held_starts,
        trials=found.trials,
        order=len(found.loop.B),
        flags=flags,
        notes=(*notes, *left_out([*records, *held])),
        invertible=True,
        invertibility=INVERSE,
        verdict=verdict(judged or fitted, bool(judged), flags, kept="in_loop"),
        candidates=candidates,
        records=records,
        held=held,
    )
    return model_of(fit, best, name, None), fit


def _in_motion(best: Candidate, records: Sequence[Record], starts: Sequence[InitialState]) -> Iterator[str]:
    """Name records without a period whose error is in their beginning: they do not begin at rest."""
    for record, start in zip(records, starts, strict=True):
        squares = best.residual(record, start) ** 2
        first = len(squares.T) // TENTH
        begun, after = (np.sqrt(part.mean(axis=1)) for part in (squares[:, :first], squares[:, first:]))
        moved = (begun > IN_MOTION * after) & (begun > SEEN_MOTION * np.ptp(record.y_um, axis=1))
        if not record.period_samples and moved.any():
            worst = int(np.argmax(begun * moved))
            yield (
                f"{PurePath(record.source).name} does not begin at rest: the rms error of "
                f"{record.outputs[worst]} is {begun[worst]:.2g} um in its first tenth, {after[worst]:.2g} um "
                "after it; leave it out, or record it from rest"
            )


def model_so_far(loop: LoopParameters, records: Sequence[Record], name: str) -> HammersteinModel:
    """Partial model of a running search, without a verdict; InputError if it is not stable.

    records : fitted records, settled periods counted from one voltage
    """
    one = records[0]
    return HammersteinModel(
        name=name,
        hysteresis=gain_model(np.eye(len(one.inputs))),
        dynamics=loop.dynamics(one.sample_time_s),
        amplitude_v=float(half_swing(records).max()),
        inputs=one.inputs,
        outputs=one.outputs,
        instruments=Instruments.ideal(one.sample_time_s),
        voltages=Voltages.of(one.rest_v, *swing_ends(records)),
    )
