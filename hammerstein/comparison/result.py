"""Result of a comparison: one entry for each model, and the recommendation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from hammerstein.comparison.fitting import Failed
from hammerstein.identification.fit import finite
from hammerstein.identification.model_selection import CLOSE, FELT, NO_BETTER, lowers
from hammerstein.identification.score import Score
from hammerstein.identification.static.normal_equations import PARTS
from hammerstein.model import HammersteinModel
from hammerstein.quantities import number_of

if TYPE_CHECKING:
    import pandas as pd

FORMAT = "hammerstein-comparison/1"
RULE = (
    f"The recommended model has the fewest parameters of those whose rms error is {CLOSE}. A model "
    "without an inverse is recommended only if no invertible model is as good, within "
    f"{100.0 * FELT:.0f} % or one standard error. These are cross-validation errors on the fitted "
    "records; the validation records do not affect the choice. Standard errors are those of the mean "
    f"difference of the squared errors to the best model over the folds: each record has {PARTS} "
    "parts, and every fourth part belongs to one fold."
)
IN_LOOP_RULE = (
    "Hysteresis in the loop is judged on a third of the experiments, with parameters from the others. It is "
    "recommended only if the same rule chooses it there, although all other models were fitted to them."
)

MUCH_LEFT = 3.0
"""Ratio of compensator error to prediction error that gives a warning; the first has two model errors."""


@dataclass(frozen=True)
class Left:
    """Error of the compensator of a model on another model.

    law : name of the law; on : name of the model that replaces the actuator
    percent : rms error about its mean in percent of the range of the path, mean of the outputs; None if the
        law cannot work
    at_range_percent : part of the samples in which a voltage is at the range
    reason : why there is no number
    """

    law: str = ""
    on: str = ""
    percent: float | None = None
    at_range_percent: float | None = None
    reason: str = ""

    @property
    def words(self) -> str:
        """The error for a table; ``plant`` for the model that replaces the actuator, else ``none``."""
        if self.percent is None:
            return "plant" if self.law and not self.on else "none"
        return f"{self.percent:.3g}"


@dataclass(frozen=True)
class Unseen:
    """Errors on the experiments to which one model was not fitted, but all others were.

    name : of that model; percent : its rms error in percent of the range
    rival, rival_percent : the other model with the least error, and that error
    experiments : their number
    """

    name: str
    percent: float
    rival: str
    rival_percent: float
    experiments: int

    def sentence(self) -> str:
        """Say both errors."""
        many = number_of(self.experiments, "experiment")
        return (
            f"On {many}, {self.name} has an error of {self.percent:.3g} % with parameters from the other "
            f"experiments; {self.rival} has {self.rival_percent:.3g} % with parameters from all of them."
        )


@dataclass(frozen=True, eq=False)
class Compared:
    """One model of a comparison.

    Parameters
    ----------
    name : name in tables
    hysteresis : its kind of hysteresis, ``none`` for a linear model
    dynamics : its linear block, in words
    parameters : number of free parameters
    fitted, validation : errors on fitted and on validation records; None if there are none
    fitted_at, validation_at : the same errors for the records at each frequency [Hz]
    folds_percent : cross-validation error on the fitted records in percent of the range; it decides the
        recommendation
    as_good : whether that is close to the least, by ``RULE``
    seconds : identification time with that of the plays before it [s]; models of one kind share it
    ns_a_sample : time of one sample of the model, all outputs together [ns]
    has_inverse : whether a compensator inverts it exactly
    inverse : that law, or why there is none
    left : compensator error
    flags : effects that it cannot represent
    model : the model, to save, simulate and compensate
    """

    name: str
    hysteresis: str
    dynamics: str
    parameters: int
    fitted: Score
    validation: Score | None
    fitted_at: Mapping[float, Score]
    validation_at: Mapping[float, Score]
    folds_percent: float
    as_good: bool
    seconds: float
    ns_a_sample: float
    has_inverse: bool
    inverse: str
    left: Left
    flags: tuple[str, ...]
    model: HammersteinModel

    @property
    def file(self) -> str:
        """Name of its model file beside the page of the comparison."""
        return f"{self.name.replace(' ', '_')}.json"

    @property
    def judged(self) -> Score:
        """Error that counts: on validation records, if there are any."""
        return self.validation or self.fitted

    @property
    def judged_at(self) -> Mapping[float, Score]:
        """The same at each frequency."""
        return self.validation_at or self.fitted_at

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: all but the times, which no two runs share."""
        own = ("name", "hysteresis", "dynamics", "parameters", "as_good", "has_inverse", "inverse")
        plain: dict[str, Any] = {name: getattr(self, name) for name in own}
        plain["folds_percent"] = finite(self.folds_percent)
        judged = {"fitted": (self.fitted, self.fitted_at), "held": (self.validation, self.validation_at)}
        for name, (score, at) in judged.items():
            plain[name] = None if score is None else _plain(score)
            plain[f"{name}_at"] = [{"frequency_hz": f, **_plain(one)} for f, one in at.items()]
        return plain | {"left": asdict(self.left), "flags": list(self.flags)}


def _plain(score: Score) -> dict[str, Any]:
    return {name: [finite(v) for v in values] for name, values in asdict(score).items()}


@dataclass(frozen=True, eq=False)
class Comparison:
    """Every kind of hysteresis and the linear models on the same records.

    Parameters
    ----------
    entries : the models, simplest first
    failed : kinds that could not be fitted, and why
    best : name of the model with the lowest error
    recommended : name of the model that ``RULE`` recommends
    inputs, outputs : names of the axes
    records, validation : names of fitted and validation records
    unseen : errors that decide on hysteresis in the loop; None if it was not asked for, or failed
    frequencies_hz : frequencies of the records, each once [Hz]
    """

    entries: tuple[Compared, ...]
    failed: tuple[Failed, ...]
    best: str
    recommended: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    records: tuple[str, ...]
    validation: tuple[str, ...]
    unseen: Unseen | None = None

    def __getitem__(self, name: str) -> Compared:
        """Entry of a model by its name; KeyError where there is none."""
        return {entry.name: entry for entry in self.entries}[name]

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Frequencies of the records that are judged [Hz]."""
        return tuple(self.entries[0].judged_at)

    @property
    def rule(self) -> str:
        """How the recommended model is chosen."""
        return RULE if self.unseen is None else f"{RULE} {IN_LOOP_RULE}"

    def sentences(self) -> list[str]:
        """Recommendation with its reason, then warnings."""
        chosen, best = self[self.recommended], self[self.best]
        where = "on the validation records" if self.validation else "on the fitted records"
        count = number_of(chosen.parameters, "parameter")
        said = [
            f"Recommended: {chosen.name}, {count}. Its error is {chosen.judged.mean_percent:.3g} % of "
            f"the range {where}, its cross-validation error {chosen.folds_percent:.3g} %."
        ]
        if best is not chosen and chosen.as_good:
            said.append(
                f"{best.name}, with {best.parameters} parameters, has a cross-validation error of "
                f"{best.folds_percent:.3g} %: {NO_BETTER}."
            )
        elif best is not chosen:
            said.append(
                f"{best.name} has a cross-validation error of {best.folds_percent:.3g} %, but no inverse."
            )
        other = min(self.entries, key=lambda entry: entry.judged.mean_percent)
        if self.validation and lowers(other.judged.mean_percent, chosen.judged.mean_percent):
            said.append(
                f"On the validation records, {other.name} has {other.judged.mean_percent:.3g} %, but "
                f"{other.folds_percent:.3g} % in cross-validation, which decides: one other record can "
                "favour a model by chance."
            )
        if self.unseen is not None:
            said.append(self.unseen.sentence())
        if not self.validation:
            said.append(
                "There is no validation record, so the error on other records is unknown: add one "
                "with --validate before you rely on this model."
            )
        left, own = chosen.left.percent, chosen.judged.mean_percent
        if left is not None and left > MUCH_LEFT * own:
            said.append(
                f"Its compensator error on {chosen.left.on} is {left:.3g} % of the path, "
                "much more than its prediction error: the model predicts well, but its inverse is "
                "inaccurate."
            )
        if chosen.flags:
            said.append(f"It cannot represent these records: {'; '.join(chosen.flags)}.")
        return said

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "format": FORMAT,
            "recommended": self.recommended,
            "best": self.best,
            "rule": self.rule,
            "unseen": self.unseen and asdict(self.unseen),
            "sentences": self.sentences(),
            "inputs": list(self.inputs),
            "outputs": list(self.outputs),
            "records": list(self.records),
            "held_records": list(self.validation),
            "models": [entry.as_dict() for entry in self.entries],
            "failed": [asdict(one) for one in self.failed],
        }

    def to_json(self) -> str:
        """Text of ``compare.json``: full precision, sorted keys."""
        return json.dumps(self.as_dict(), indent=1, sort_keys=True, allow_nan=False) + "\n"

    def to_frame(self) -> pd.DataFrame:
        """One row a model as a pandas table; errors are means of the outputs in percent of the range."""
        import pandas as pd

        rows = [
            {
                "model": entry.name,
                "hysteresis": entry.hysteresis,
                "parameters": entry.parameters,
                "fitted_percent": entry.fitted.mean_percent,
                "held_percent": None if entry.validation is None else entry.validation.mean_percent,
                "folds_percent": finite(entry.folds_percent),
                "as_good": entry.as_good,
                "seconds": entry.seconds,
                "ns_a_sample": entry.ns_a_sample,
                "has_inverse": entry.has_inverse,
                "left_percent": entry.left.percent,
                "left_on": entry.left.on,
                "recommended": entry.name == self.recommended,
            }
            for entry in self.entries
        ]
        return pd.DataFrame(rows).set_index("model")
