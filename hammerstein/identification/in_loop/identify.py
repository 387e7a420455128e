"""Identification of a model with hysteresis inside its loop, selected by cross-validation."""

import contextlib
import hashlib
import itertools
import json
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.fit import Fit
from hammerstein.identification.identify import from_last_rest
from hammerstein.identification.in_loop.parameters import LoopParameters
from hammerstein.identification.in_loop.result import Found, result_of
from hammerstein.identification.in_loop.search import Progress, Search, SettledPeriod
from hammerstein.identification.in_loop.selection import Selection, from_one_point, settled_periods
from hammerstein.identification.in_loop.start import (
    linear_start,
    with_band,
    with_ends,
    with_plays,
    with_products,
)
from hammerstein.identification.linear.coupled import measured_response
from hammerstein.identification.linear.state_space import fit_state_space
from hammerstein.identification.model_selection import Trial
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.runtime.resources import one_blas_thread

STATES = (2, 4, 8, 16)
"""Of each output, where no order is given, until more are not better. A model with more than it needs
explains with further modes, and badly, that a resonance moves with the amplitude."""
FEWEST = 3
"""Experiments that this takes."""
PATIENCE = 4
"""Steps in a row after which a search ends that lowers the error of what is held back no more."""
GAINED = 0.99
"""Part of the error held back that must be left, or more paths are not worth their numbers."""


@dataclass(frozen=True)
class LoopSettings:
    """How hysteresis in a loop is identified.

    order : states of the linear block, even; found from the number of outputs if not given
    minutes : after which the best model found is given
    """

    order: int | None = None
    minutes: float = 60.0


@one_blas_thread()
def identify_in_loop(
    records: Sequence[Record],
    settings: LoopSettings | None = None,
    *,
    validation: Sequence[Record] = (),
    name: str = "identified",
    kept: Path | None = None,
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
    kept : file of the parameters found so far, written after every step; a search continues from it

    Raises
    ------
    IdentificationError : too few experiments, or linear dynamics are as good on the selection experiments
    InputError : records of several sample times, or a file of other records
    """
    ready, held = from_one_point(from_last_rest(records), from_last_rest(validation) if validation else ())
    _refuse(ready, held)
    with ThreadPoolExecutor(2) as pool:
        work = _Work(settings or LoopSettings(), kept, _digest(ready), progress, pool)
        found = work.resumed(ready) if kept is not None and kept.is_file() else work.chosen(ready)
    if not found.chosen.percent < found.linear.percent:
        raise IdentificationError(
            f"hysteresis in the loop has an error of {found.chosen.percent:.3g} % of the range on the "
            f"selection experiments, scaled to one size, linear dynamics alone {found.linear.percent:.3g} %: "
            "it does not improve the model. Identify without --hysteresis-in-loop"
        )
    return result_of(found, ready, held, name)


class _Best(NamedTuple):
    """The best structure so far, and the steps in which it was found."""

    found: LoopParameters
    trial: Trial
    steps: int


class _Work:
    """One search: what was asked, when it ends, and what was tried."""

    def __init__(
        self,
        settings: LoopSettings,
        kept: Path | None,
        digest: str,
        tell: Callable[[str], None],
        pool: Executor,
    ) -> None:
        self.settings, self.kept, self.digest, self.tell, self.pool = settings, kept, digest, tell, pool
        self.begun_s = time.monotonic()
        self.trials: list[Trial] = []

    def chosen(self, records: Sequence[Record]) -> Found:
        """Choose structure and steps on a third of the experiments, and fit all of them."""
        self.tell("fitting linear dynamics")
        blocks = _linear(records, self.settings.order)
        block = next(blocks)
        periods = settled_periods(records, block.respond)
        parts = Selection.of(periods)
        best, self.trials = None, [parts.of_linear(block)]
        for one in itertools.chain([block], blocks):
            linear, before = parts.of_linear(one), best
            if linear.percent < self.trials[0].percent:
                self.trials[0], block = linear, one
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
        return Found(self._all(best, periods), block, self._marked(best))

    def resumed(self, records: Sequence[Record]) -> Found:
        """Go on with the file of an interrupted search."""
        assert self.kept is not None
        found = LoopParameters.load(self.kept)
        more = json.loads(self.kept.read_text(encoding="utf-8")).get("search", {})
        if more.get("of") != self.digest or "trials" not in more:
            what = "belongs to a search on other records or of another version; remove it to start again"
            raise InputError(str(self.kept), what)
        self.tell("continuing the interrupted search")
        self.trials = [Trial(name, count, np.array(squares)) for name, count, squares in more["trials"]]
        block = next(_linear(records, len(found.B)))
        best = _Best(found, self.trials[-1], more["steps"])
        return Found(self._all(best, settled_periods(records, block.respond)), block, self._marked(best))

    def _of_order(self, block: LinearBlock, parts: Selection) -> _Best:
        """Plays in the loop of linear dynamics of one order.

        Plays that move once leave an error that states beyond the true order explain, so that orders are
        compared with plays that move twice, and enough of them.
        """
        begun = linear_start(block, parts.seen)
        return self._grown(
            self._tried(begun, None, parts),
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
                best = self._better_of(best, self._tried(larger, best, parts))
        return best

    def _better_of(self, best: _Best | None, tried: _Best) -> _Best:
        return tried if best is None or tried.trial.percent < GAINED * best.trial.percent else best

    def _tried(self, begun: LoopParameters, best: _Best | None, parts: Selection) -> _Best:
        """Search until the error held back falls no more."""
        least = np.inf if best is None else GAINED * best.trial.percent
        tried = _Best(begun, Trial(begun.describe(), len(begun.vector()), np.array([np.inf])), 0)

        def tell(progress: Progress) -> None:
            nonlocal tried
            now = parts.of_loop(progress.found, self.pool)
            self.tell(f"{now.name}, step {progress.step}: {now.percent:.3g} % on the selection experiments")
            if now.percent < tried.trial.percent:
                tried = _Best(progress.found, now, progress.step + 1)
                if now.percent < least:
                    self._keep(tried)
            if self._is_late(0.5) or progress.step + 1 - tried.steps >= PATIENCE:
                raise StopIteration

        _run(begun, parts.seen, self.pool, tell, Search())
        self.trials.append(tried.trial)
        return tried

    def _all(self, best: _Best, periods: Sequence[SettledPeriod]) -> LoopParameters:
        """Fit all experiments with the structure chosen, by as many steps."""
        found = best.found

        def tell(progress: Progress) -> None:
            nonlocal found
            self._keep(best._replace(found=progress.found, steps=best.steps - progress.step - 1))
            left = float(np.sqrt(np.mean(progress.rms**2)))
            self.tell(f"all experiments, step {progress.step + 1} of {best.steps}: {left:.4g} um")
            if self._is_late():
                raise StopIteration

        self._keep(best)
        _run(found, periods, self.pool, tell, Search(steps=best.steps))
        return found

    def _is_late(self, part: float = 1.0) -> bool:
        return time.monotonic() > self.begun_s + part * 60.0 * self.settings.minutes

    def _marked(self, best: _Best) -> tuple[Trial, ...]:
        return tuple(replace(trial, kept=trial is best.trial) for trial in self.trials)

    def _keep(self, best: _Best) -> None:
        """Write what an interrupted search goes on from: the best structure is the last trial."""
        if self.kept is not None:
            trials = [*(trial for trial in self.trials if trial is not best.trial), best.trial]
            plain = [[trial.name, trial.parameters, trial.squares.tolist()] for trial in trials]
            best.found.save(self.kept, {"of": self.digest, "steps": best.steps, "trials": plain})


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


def _linear(records: Sequence[Record], order: int | None) -> Iterator[LinearBlock]:
    """State spaces of all experiments, of even orders, each when it is asked for."""
    orders = [order + order % 2] if order else [states * len(records[0].y_um) for states in STATES]
    response = measured_response(records)
    yield fit_state_space(response, orders[0])
    with contextlib.suppress(IdentificationError):  # the records have too few lines for more states
        yield from (fit_state_space(response, one) for one in orders[1:])


def _digest(records: Sequence[Record]) -> str:
    told = hashlib.sha256()
    for record in records:
        told.update(record.u_v.tobytes() + record.y_um.tobytes())
    return told.hexdigest()[:16]
