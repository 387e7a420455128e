"""Identification of a model with hysteresis inside its loop, selected by cross-validation."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.voltages import Verdict, Voltages
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.identify import from_last_rest
from hammerstein.identification.in_loop.parameters import LoopParameters
from hammerstein.identification.in_loop.search import Progress, Search, SettledPeriod
from hammerstein.identification.in_loop.start import (
    linear_start,
    with_band,
    with_plays,
    with_products,
)
from hammerstein.identification.linear.coupled import measured_response
from hammerstein.identification.linear.state_space import fit_state_space
from hammerstein.identification.score import Score, score_of
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.runtime.resources import one_blas_thread

STATES = (2, 4, 6)
"""Of each output, where no order is given. A model with more than it needs explains with further modes, and
badly, that a resonance moves with the amplitude."""
HELD = 3
"""One of so many experiments is held back while the structure is chosen."""
FEWEST = 3
"""Experiments that this takes."""
PATIENCE = 4
"""Steps in a row after which a search ends that lowers the error of what is held back no more."""
GAINED = 0.99
"""Part of the error held back that must be left, or more paths are not worth their numbers."""
SETTLED = 1e-3
"""Part of an output by which two periods may differ that count as settled: a fifth of a noise of 0.5 %."""
MOST_BEFORE = 8
"""Periods that a simulation runs through at most before the one that counts."""


@dataclass(frozen=True)
class LoopSettings:
    """How hysteresis in a loop is identified.

    order : states of the linear block, even; found from the number of outputs if not given
    minutes : after which the best model found is given
    """

    order: int | None = None
    minutes: float = 60.0


Respond = Callable[[Array], tuple[Array, Any]]
"""Outputs (p, sample) from rest to inputs (m, sample), and the state after."""
NOT_JUDGED = Score((), (), ())


@dataclass(frozen=True, eq=False)
class LoopFit:
    """Result: parameters, steps of the last search, and its errors.

    held_um, linear_um : rms error on the selection experiments of the structure before all experiments were
        fitted, and of linear dynamics [um]
    judged : errors of the final model on the validation records, or on the fitted ones if there are none
    validated : whether they are from validation records
    """

    found: LoopParameters
    held_um: float
    linear_um: float
    steps: int
    judged: Score = NOT_JUDGED
    validated: bool = False

    def statement(self) -> str:
        """Say how large the model is, and how good against linear dynamics."""
        h, plays = self.found.r.shape
        return (
            f"order {len(self.found.B)}, {h} paths of {plays} plays, {self.found.K.shape[1]} "
            f"products: {self.held_um:.4g} um rms on the selection experiments; linear dynamics "
            f"{self.linear_um:.4g} um"
        )

    def verdict(self) -> Verdict:
        """Verdict for the model file: its error, and by how much the loop improves it."""
        return Verdict(
            flagged=False,
            held_out=self.validated,
            sentence=f"Hysteresis in the loop: {self.statement()}.",
            nrmse_percent=self.judged.nrmse_percent,
        )


@one_blas_thread()
def identify_in_loop(
    records: Sequence[Record],
    settings: LoopSettings | None = None,
    *,
    validation: Sequence[Record] = (),
    name: str = "identified",
    kept: Path | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[HammersteinModel, LoopFit]:
    """Identify a model with plays and products inside its loop from the simulated output.

    The search begins with linear dynamics. Plays, then more paths for the lower and the upper modes, then
    products of z are tried on two thirds of the experiments. Each is kept if it lowers the error on the other
    third, which also sets the number of steps. Then the chosen structure is fitted to all experiments.

    Parameters
    ----------
    records : experiments at several amplitudes, on one sample time
    validation : records for the final error; they affect nothing else
    kept : file of the parameters found so far, written after every step; a search continues from it

    Raises
    ------
    IdentificationError : too few experiments, or linear dynamics are as good on the validation experiments
    InputError : records of several sample times, or a file of other records
    """
    asked, ready = settings or LoopSettings(), from_last_rest(records)
    held = from_last_rest(validation) if validation else ()
    _refuse(ready, held)
    work = _Work(asked, time.monotonic() + 60.0 * asked.minutes, kept, _digest(ready), progress)
    with ThreadPoolExecutor(2) as pool:
        fit = work.resumed(ready, pool) if kept is not None and kept.is_file() else work.chosen(ready, pool)
        fit = _judged(fit, held or ready, _working_point(ready), pool)
    fit = replace(fit, validated=bool(held))
    if not fit.held_um < fit.linear_um:
        raise IdentificationError(
            f"hysteresis in the loop has an error of {fit.held_um:.4g} um on the selection "
            f"experiments, linear dynamics alone {fit.linear_um:.4g} um: it does not improve the "
            "model. Identify without --hysteresis-in-loop"
        )
    return _model(fit, records, ready, name), fit


def _model(fit: LoopFit, records: Sequence[Record], ready: Sequence[Record], name: str) -> HammersteinModel:
    """Model of the parameters, with the voltages and the sample time of its records, and its errors."""
    sent = np.hstack([record.u_v + record.rest_v[:, None] for record in ready])
    one = ready[0]
    return replace(
        fit.found.model(name, one.sample_time_s, float(np.abs(sent).max()), one.inputs, one.outputs),
        voltages=Voltages.of(_working_point(ready), sent.min(axis=1), sent.max(axis=1)),
        instruments=Instruments.ideal(one.sample_time_s),
        provenance={"records": [Path(record.source).name for record in records]},
        verdict=fit.verdict(),
    )


@dataclass(frozen=True)
class _Work:
    settings: LoopSettings
    end_s: float
    kept: Path | None
    digest: str
    tell: Callable[[str], None]

    def chosen(self, records: Sequence[Record], pool: Executor) -> LoopFit:
        """Choose structure and steps on a third of the experiments, and fit all of them."""
        self.tell("fitting linear dynamics")
        blocks = _linear(records, self.settings.order)
        periods = _periods(records, blocks[0].respond, _working_point(records))
        back = _held_back(periods)
        seen = [p for p, is_back in zip(periods, back, strict=True) if not is_back]
        held = [p for p, is_back in zip(periods, back, strict=True) if is_back]
        linear = min(_linear_rms(block, held) for block in blocks)
        best = LoopFit(linear_start(blocks[0], seen), np.inf, linear, 0)
        for block in blocks:
            best = self._better(linear_start(block, seen), best, seen, held, pool)
        poles = np.linalg.eigvals(best.found.full())
        middle = float(np.median(np.abs(np.angle(poles))))
        grown: tuple[Callable[[LoopParameters], LoopParameters | None], ...] = (
            partial(with_band, low=middle, high=np.pi, periods=seen),
            partial(with_band, low=0.0, high=middle, periods=seen),
            with_products,
            partial(with_plays, periods=seen),
        )
        for grow in grown:
            begun = grow(best.found)
            if begun is not None:
                best = self._better(begun, best, seen, held, pool)
        return self._all(best, periods, pool)

    def _better(
        self,
        begun: LoopParameters,
        best: LoopFit,
        seen: Sequence[SettledPeriod],
        held: Sequence[SettledPeriod],
        pool: Executor,
    ) -> LoopFit:
        """Search from other parameters if there is time; return the better fit."""
        if np.isfinite(best.held_um) and time.monotonic() > self.end_s - 30.0 * self.settings.minutes:
            return best
        trial = self._tried(begun, best, seen, held, pool)
        return trial if trial.held_um < GAINED * best.held_um else best

    def _tried(
        self,
        begun: LoopParameters,
        best: LoopFit,
        seen: Sequence[SettledPeriod],
        held: Sequence[SettledPeriod],
        pool: Executor,
    ) -> LoopFit:
        """Search until the error held back falls no more."""
        trial = replace(best, found=begun, held_um=np.inf)

        def tell(progress: Progress) -> None:
            nonlocal trial
            now = _rms(progress.found, held, pool)
            self.tell(
                f"{len(begun.r)} paths, step {progress.step}: {now:.4g} um on the selection experiments"
            )
            if now < trial.held_um:
                trial = LoopFit(progress.found, now, best.linear_um, progress.step + 1)
                if now < GAINED * best.held_um:
                    self._keep(trial)
            late = time.monotonic() > self.end_s - 30.0 * self.settings.minutes
            if late or progress.step + 1 - trial.steps >= PATIENCE:
                raise StopIteration

        self._run(begun, seen, pool, tell, Search())
        return trial

    def _all(self, best: LoopFit, periods: Sequence[SettledPeriod], pool: Executor) -> LoopFit:
        """Fit all experiments with the structure chosen, by as many steps."""
        found = best.found

        def tell(progress: Progress) -> None:
            nonlocal found
            found = progress.found
            self._keep(replace(best, found=found, steps=best.steps - progress.step - 1))
            left = float(np.sqrt(np.mean(progress.rms**2)))
            self.tell(f"all experiments, step {progress.step + 1} of {best.steps}: {left:.4g} um")
            if time.monotonic() > self.end_s:
                raise StopIteration

        self._keep(best)
        self._run(found, periods, pool, tell, Search(steps=best.steps))
        return replace(best, found=found)

    def resumed(self, records: Sequence[Record], pool: Executor) -> LoopFit:
        """Go on with the file of an interrupted search."""
        assert self.kept is not None
        found = LoopParameters.load(self.kept)
        more = json.loads(self.kept.read_text(encoding="utf-8")).get("search", {})
        if more.get("of") != self.digest:
            raise InputError(str(self.kept), "belongs to a search on other records; remove it to start again")
        self.tell("continuing the interrupted search")
        block = _linear(records, len(found.B))[0]
        periods = _periods(records, block.respond, _working_point(records))
        return self._all(LoopFit(found, more["held_um"], more["linear_um"], more["steps"]), periods, pool)

    def _keep(self, fit: LoopFit) -> None:
        if self.kept is not None:
            more = {"of": self.digest, "held_um": fit.held_um, "linear_um": fit.linear_um, "steps": fit.steps}
            fit.found.save(self.kept, more)

    @staticmethod
    def _run(
        begun: LoopParameters,
        periods: Sequence[SettledPeriod],
        pool: Executor,
        tell: Callable[[Progress], None],
        search: Search,
    ) -> None:
        try:
            search.run(begun, periods, pool, tell)
        except StopIteration:
            return


def _refuse(records: Sequence[Record], held: Sequence[Record]) -> None:
    if len(records) < FEWEST:
        raise IdentificationError(
            f"hysteresis in the loop needs {FEWEST} experiments, because some select the structure; "
            f"there {('is' if len(records) == 1 else 'are')} {len(records)}. Record more, at several "
            "amplitudes"
        )
    if len({record.sample_time_s for record in (*records, *held)}) > 1:
        raise InputError("records", "have several sample times; resample them to the same sample time")


def _linear(records: Sequence[Record], order: int | None) -> list[LinearBlock]:
    """State spaces of all experiments, of even orders."""
    orders = [order + order % 2] if order else [states * len(records[0].y_um) for states in STATES]
    response = measured_response(records)
    return [fit_state_space(response, one) for one in orders]


def _held_back(periods: Sequence[SettledPeriod]) -> list[bool]:
    """Which experiments select the structure: one of ``HELD`` in the order of their amplitudes.

    Without the largest amplitudes, the other experiments do not determine what the hysteresis does there.
    """
    places = np.argsort(np.argsort([p.u.std() for p in periods], kind="stable"))
    return [bool(place % HELD == HELD // 2) for place in places]


def _period(record: Record) -> int:
    """Samples of its settled period; 0 for a record from rest."""
    n = record.period_samples or 0
    return n if record.samples >= n else 0


def _working_point(records: Sequence[Record]) -> Array:
    """Voltages [V] from which the loop counts: where a record began at rest; 0 V if all are periods.

    A settled period began anywhere.
    """
    begun = [record.rest_v for record in records if not _period(record)]
    return begun[0] if begun else np.zeros(len(records[0].u_v))


def _judged(fit: LoopFit, records: Sequence[Record], working_point_v: Array, pool: Executor) -> LoopFit:
    """Add the errors of the final model on records."""
    block = fit.found.dynamics(records[0].sample_time_s).block()
    periods = _periods(records, block.respond, working_point_v)
    errors = list(pool.map(lambda p: p.left(fit.found.simulate(p.u, p.warm)), periods))
    return replace(fit, judged=score_of(errors, [p.y for p in periods]))


def _periods(records: Sequence[Record], respond: Respond, working_point_v: Array) -> list[SettledPeriod]:
    """Settled periods, counted from a working point, or whole records, counted from where they began.

    respond : of a model that settles as the actuator does
    """
    found = []
    for record in records:
        n = _period(record)
        one = SettledPeriod(record.u_v, record.y_um, 1.0, 0)
        if n:
            count = record.samples // n
            first = record.samples - max(count - 1, 1) * n
            y = record.y_um[:, first:].reshape(len(record.y_um), -1, n).mean(axis=1)
            one = SettledPeriod(record.u_v[:, -n:] + (record.rest_v - working_point_v)[:, None], y, 1.0, 0)
            one = one._replace(warm=n * _periods_before(respond, one))
        found.append(one)
    return found


def _periods_before(respond: Respond, period: SettledPeriod) -> int:
    """Whole periods after which a block repeats itself: plays remember the largest turns of one."""
    n = period.u.shape[1]
    y = respond(np.tile(period.u, MOST_BEFORE + 1))[0].reshape(len(period.y), -1, n)
    moved = np.abs(y[:, 1:] - y[:, :-1]).max(axis=2) / np.abs(y[:, -1]).max(axis=1, keepdims=True)
    settled = np.flatnonzero((moved < SETTLED).all(axis=0))
    return int(settled[0]) + 1 if len(settled) else MOST_BEFORE


def _linear_rms(block: LinearBlock, held: Sequence[SettledPeriod]) -> float:
    return _of([p.left(block.respond(p.sent)[0][:, p.warm :]) for p in held])


def _rms(found: LoopParameters, periods: Sequence[SettledPeriod], pool: Executor) -> float:
    return _of(list(pool.map(lambda p: p.left(found.simulate(p.u, p.warm)), periods)))


def _of(errors: Sequence[Array]) -> float:
    with np.errstate(all="ignore"):  # of one that diverged
        return float(np.sqrt(np.mean([np.mean(e * e) for e in errors])))


def _digest(records: Sequence[Record]) -> str:
    told = hashlib.sha256()
    for record in records:
        told.update(record.u_v.tobytes() + record.y_um.tobytes())
    return told.hexdigest()[:16]
