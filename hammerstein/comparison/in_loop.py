"""Hysteresis in the loop as one more candidate, judged on experiments that it was not fitted to."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from hammerstein.comparison.fitting import Failed, Fitted
from hammerstein.comparison.inverting import Inverse, inverse_of
from hammerstein.comparison.result import Unseen
from hammerstein.dynamics import discretise
from hammerstein.errors import HammersteinError
from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop
from hammerstein.identification.in_loop.selection import Selection, settled_periods
from hammerstein.identification.model_selection import Trial, as_good, chosen, least
from hammerstein.identification.options import PLAYS
from hammerstein.identification.sensor_model import SensorModel
from hammerstein.records.record import Record

NAME = "hysteresis in the loop"


@dataclass(frozen=True, eq=False)
class LoopFit:
    """Hysteresis in the loop, and the errors of every model on experiments that it was not fitted to.

    records : fitted and validation records of its own errors: settled periods count from one voltage
    trials : of the other models, then its own; only the others were fitted to these experiments
    """

    fitted: Fitted
    inverse: Inverse
    records: tuple[tuple[Record, ...], tuple[Record, ...]]
    trials: tuple[Trial, ...]

    @property
    def trial(self) -> Trial:
        """Its own errors."""
        return self.trials[-1]

    @property
    def wins(self) -> bool:
        """Whether no other model is as good or has its error with fewer parameters."""
        return chosen(self.trials) == len(self.trials) - 1

    @property
    def good(self) -> set[str]:
        """Names of the models whose errors there are the least, or hardly above it."""
        return {self.trials[i].name for i in as_good(self.trials)}

    def unseen(self) -> Unseen:
        """Its error and that of the best other model."""
        rival = self.trials[least(self.trials[:-1])]
        return Unseen(NAME, self.trial.percent, rival.name, rival.percent, len(self.trial.squares))


def fit_in_loop(
    records: Sequence[Record],
    settings: LoopSettings,
    validation: Sequence[Record],
    others: Sequence[tuple[Fitted, Trial]],
    progress: Callable[[str], None],
) -> LoopFit | Failed:
    """Identify hysteresis in the loop, and judge all models on a third of the experiments.

    They choose its structure and its number of steps, with parameters that are fitted to the other
    experiments. The other models were fitted to all of them, so that an advantage of the loop is no part of
    the fit.

    others : the other models, and their errors where they are judged among themselves
    """
    begun = time.process_time()
    try:
        model, fit = identify_in_loop(records, settings, validation=validation, name=NAME, progress=progress)
    except HammersteinError as error:
        return Failed(NAME, PLAYS, str(error))
    seconds = time.process_time() - begun
    ours = Fitted(
        NAME, PLAYS, model, fit.candidates["in_loop"], fit.starts, fit.held_starts, fit.flags, seconds
    )
    inverse = inverse_of(model, fit.sample_time_s)
    block = discretise(fit.candidates["linear_dynamics"].dynamics, fit.sample_time_s)
    parts = Selection.of(settled_periods(fit.records, block.respond))
    ideal = [(replace(one.candidate, sensor=SensorModel()), trial) for one, trial in others]
    trials = [parts.of_model(candidate, trial, fit.records[0]) for candidate, trial in ideal]
    own = next(trial for trial in fit.trials if trial.kept)
    trials.append(replace(own, name=NAME, usable=inverse.exact, kept=False))
    return LoopFit(ours, inverse, (fit.records, fit.held), tuple(trials))
