"""Judgements of claims on simulated actuators, and causes of disagreement."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

from hammerstein.errors import InputError
from hammerstein.metrics import Row
from hammerstein.paper.claims import Claim, FactorName
from hammerstein.scenario.assessment import Judgement

CLAIMED = "value"  # the number of a claim
CAUSES: dict[FactorName, str] = {
    "sensor": "the sensor",
    "dynamics": "the dynamics",
    "passes": "the single pass of the law per sample",
    "sample_time": "the sample time",
    "identification_amplitude": "the amplitude of identification",
    "identification_frequency": "the frequency of identification",
}
WANDERS = 1.5  # the divisor of a ratio with a wider range is near the noise


@dataclass(frozen=True)
class Simulated:
    """The figure of a claim on one simulated actuator.

    value : of the run itself, not finite where the sweep ends before the figure is reached
    agrees : None where the verdict depends on the seed or the sample time, or there is no figure
    low, high : ends over all seeds and sample times; shown : the figure with the digits that hold
    """

    actuator: str
    value: float
    agrees: bool | None
    low: float
    high: float
    shown: str

    @classmethod
    def of(cls, actuator: str, claim: Claim, values: Sequence[float]) -> Simulated:
        """Judge a claim by its figure in every run; the first is of the run itself."""
        verdicts = {None if math.isnan(v) else claim.agreement.holds(v, claim.paper) for v in values}
        known = [value for value in values if math.isfinite(value)] or [math.nan]
        low, high = min(known), max(known)
        agrees = verdicts.pop() if len(verdicts) == 1 else None
        return cls(actuator, values[0], agrees, low, high, _shown(claim, low, high, len(values)))

    @property
    def word(self) -> str:
        """Verdict as text."""
        return "undecided" if self.agrees is None else "met" if self.agrees else "not met"

    def as_dict(self) -> dict[str, object]:
        """Return plain JSON; a value that does not exist is left out."""
        return {k: v for k, v in asdict(self).items() if not isinstance(v, float) or math.isfinite(v)}


def _shown(claim: Claim, low: float, high: float, runs: int) -> str:
    """Digits that hold; of a ratio that wanders and must only be large, its lower end."""
    if math.isnan(low):
        return "beyond the sweep"
    if runs == 1:
        return f"{low:.3g}"
    wanders = high > WANDERS * low > 0.0 and claim.over is not None and claim.agreement.at_most is None
    return f"more than {_floor(low)}" if wanders else _ends(low, high)


def _ends(low: float, high: float) -> str:
    """Both ends of a range with two digits, or with three where the range is less than the second digit.

    >>> _ends(1.41, 1.52), _ends(19.43, 20.10), _ends(116.44, 116.47)
    ('1.4 to 1.5', '19.4 to 20.1', '116')
    """
    largest = max(abs(low), abs(high))
    second = 10.0 ** (math.floor(math.log10(largest)) - 1) if largest > 0.0 else 0.0
    digits = 2 if high - low >= second else 3
    return " to ".join(dict.fromkeys(f"{float(f'{end:.{digits}g}'):g}" for end in (low, high)))


def _floor(value: float) -> str:
    """One digit, rounded down.

    >>> _floor(299.0), _floor(5.54)
    ('200', '5')
    """
    unit = 10.0 ** math.floor(math.log10(value))
    return f"{math.floor(value / unit) * unit:g}"


@dataclass(frozen=True)
class Change:
    """Figure of a claim after a change of only one or two factors of the chain.

    factor : names; words : description, such as ``with an ideal sensor``
    value : new figure; shown : the figure with the digits that hold
    agrees : whether the claim is met then, with every seed and sample time
    """

    factor: str
    words: str
    value: float
    shown: str
    agrees: bool

    @classmethod
    def of(cls, factor: str, words: str, claim: Claim, values: Sequence[float]) -> Change:
        """Judge a change by its figure in every run.

        A single run is enough to say that it does not bring agreement; two of its digits are shown, or three
        where two would agree.
        """
        found = Simulated.of("", claim, values)
        digits = 2 if claim.agreement.holds(float(f"{values[0]:.2g}"), claim.paper) is found.agrees else 3
        shown = found.shown if len(values) > 1 else f"{values[0]:.{digits}g}"
        return cls(factor, words, values[0], shown, found.agrees is True)

    @property
    def cause(self) -> str:
        """The factors as words."""
        return " and ".join(words for name, words in CAUSES.items() if name in self.factor.split(" + "))


@dataclass(frozen=True)
class ClaimJudgement(Judgement):
    """A claim and its figure on the simulated actuators; the first is the scenario's own.

    reason : why the claim is not met, in one short sentence; details : result of every change
    cause : the only factor, or pair of factors, that gives agreement; empty if there is none or several
    """

    statement: str
    paper: float | None
    unit: str
    wanted: str
    simulated: tuple[Simulated, ...]
    reason: str
    calibrated: bool = False
    changes: tuple[Change, ...] = ()
    cause: str = ""
    details: str = ""
    quote: str = ""

    @property
    def ratio(self) -> str:
        """Simulated over paper with the digits that hold, for the scenario's own actuator; empty without."""
        own = self.simulated[0]
        known = self.paper and math.isfinite(own.low)
        return _ends(*sorted((own.low / self.paper, own.high / self.paper))) if self.paper and known else ""

    @property
    def word(self) -> str:
        """Verdict on the scenario's own actuator."""
        return self.simulated[0].word

    @property
    def agrees(self) -> bool:
        """Whether the scenario's own actuator agrees."""
        return self.simulated[0].agrees is True

    @property
    def printed(self) -> str:
        """The paper's figure with its unit; empty if it prints none."""
        return "" if self.paper is None else f"{self.paper:g} {self.unit}".strip()

    def cells(self) -> dict[str, str]:
        """Its line in a table, by column: the scenario's own actuator; the details name the others."""
        own, *others = self.simulated
        more = [f"Other actuators: {', '.join(f'{one.actuator} {one.shown}' for one in others)}"] * bool(
            others
        )
        return {
            "claim": self.id,
            "statement": self.statement,
            "reason": self.reason,
            "paper": self.printed,
            "simulated": f"{own.shown} {self.unit * own.shown[-1:].isdigit()}".strip(),
            "ratio": self.ratio,
            "wanted": self.wanted,
            "judgement": self.word,
            "details": _sentences([self.details, *more]),
        }

    def numbers(self) -> Iterator[tuple[Mapping[str, str], Mapping[str, float]]]:
        """The figure of each actuator; one that has no such row gives none."""
        for one in self.simulated:
            if math.isfinite(one.value):
                yield {"claim": self.id, "actuator": one.actuator}, {CLAIMED: one.value}

    def as_dict(self) -> dict[str, object]:
        """Return plain JSON; a figure that does not exist is left out."""
        content = {k: v for k, v in asdict(self).items() if v is not None and k != "simulated"}
        content["answers"] = [one.as_dict() for one in self.simulated]  # their name in report.json
        content["changes"] = [asdict(change) for change in self.changes if math.isfinite(change.value)]
        return content


def judgements(
    claims: Sequence[Claim],
    runs_by_actuator: Mapping[str, Sequence[Sequence[Row]]],
    changes_of: Callable[[Claim], Sequence[Change]] = lambda claim: (),
) -> tuple[ClaimJudgement, ...]:
    """Judge every claim by the rows of every actuator; the first actuator is the scenario's own.

    Parameters
    ----------
    claims : the claims
    runs_by_actuator : rows of each actuator, of the run itself and of its repeats
    changes_of : figures of a claim that is not met, with one factor changed at a time

    Raises InputError if a claim selects no row.
    """
    return tuple(_judged(claim, runs_by_actuator, changes_of) for claim in claims)


def _judged(
    claim: Claim,
    runs_by_actuator: Mapping[str, Sequence[Sequence[Row]]],
    changes_of: Callable[[Claim], Sequence[Change]],
) -> ClaimJudgement:
    rows = next(iter(runs_by_actuator.values()))[0]
    if not any(claim.selects(row) for row in rows):
        raise InputError(f"claim {claim.id}", "selects no row that has this metric; look into rms.csv")
    found = {name: [claim.value(rows) for rows in runs] for name, runs in runs_by_actuator.items()}
    simulated = tuple(Simulated.of(name, claim, values) for name, values in found.items())
    own = simulated[0]
    unmet = own.agrees is False
    changes = tuple(changes_of(claim)) if unmet and not claim.calibrated else ()
    cause, reason = _cause(changes) if unmet else ("", _open(own))
    if unmet and claim.calibrated:
        reason = "The actuator was fitted to several such figures together; no change was tried."
    tried = [f"{change.words} {change.shown}" for change in changes if math.isfinite(change.value)]
    details = [_cut(claim, rows), "; ".join(tried), claim.note if own.agrees is not True else ""]
    return ClaimJudgement(
        claim.id,
        claim.statement,
        claim.paper,
        claim.unit,
        claim.agreement.words(),
        simulated,
        reason,
        claim.calibrated,
        changes,
        cause,
        _sentences(details),
        claim.quote,
    )


def _open(own: Simulated) -> str:
    """Why there is no verdict; empty where there is one."""
    if own.agrees is not None:
        return ""
    if math.isnan(own.low):
        return "The sweep ends before the value is reached."
    return "The verdict depends on the sample time or the seed."


def _sentences(said: Sequence[str]) -> str:
    """Join sentences and capitalise them; empty ones are left out."""
    return ". ".join(text[0].upper() + text[1:] for text in said if text)


def _cut(claim: Claim, rows: Sequence[Row]) -> str:
    """Number of samples of a claim that the range of the drive clipped, in words."""
    cut = max((row.saturated_samples or 0 for row in rows if claim.selects(row)), default=0)
    return f"the reference exceeds the range: the drive clipped {cut:g} samples" if cut else ""


def _cause(changes: Sequence[Change]) -> tuple[str, str]:
    """The change that alone brings agreement, and a sentence of about fifteen words.

    Single factors take precedence over pairs. If several suffice, none is the cause.
    """
    enough = [c for c in changes if c.agrees]
    singles = [c for c in enough if " + " not in c.factor]
    found = singles or enough
    if len(found) == 1:
        cause = found[0].cause
        return cause, f"The claim is met {found[0].words}: the value is {found[0].shown}."
    what = "change" if singles else "pair of changes"
    if found:
        return "", f"Not unique: more than one {what} brings agreement."
    if not changes:
        return "", ""
    return "", "No change of one or two factors of this actuator brings agreement."
