"""What simulated actuators make of claims, and what is the cause where they do not agree."""

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
    "sensor": "the sensor, in identification and judgement",
    "dynamics": "the dynamics",
    "passes": "the law's one pass a sample",
    "sample_time": "the sample time",
    "identification_amplitude": "the amplitude of identification",
    "identification_frequency": "the frequency of identification",
}
NO_CAUSE = 0.9  # of the distance from agreement; a factor that leaves more of it explains nothing


@dataclass(frozen=True)
class Simulated:
    """The figure of a claim on one simulated actuator."""

    actuator: str
    value: float
    agrees: bool

    def text(self) -> str:
        """The value in three digits."""
        return f"{self.value:.3g}"

    def as_dict(self) -> dict[str, object]:
        """Give plain JSON; a value that does not exist is left out."""
        return {k: v for k, v in asdict(self).items() if k != "value" or math.isfinite(self.value)}


@dataclass(frozen=True)
class Change:
    """What a claim's figure becomes when one factor of the chain is changed and nothing else.

    factor : its name; words : what was done, such as ``with an ideal sensor``; value : the figure then
    """

    factor: FactorName
    words: str
    value: float


@dataclass(frozen=True)
class ClaimJudgement(Judgement):
    """A claim and its figure on the simulated actuators; the first is the scenario's own.

    reason : why that one does not agree, with numbers; cause : the factor alone, empty if there is none
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

    @property
    def ratio(self) -> float | None:
        """Simulated over paper, for the scenario's own actuator."""
        return self.simulated[0].value / self.paper if self.paper else None

    @property
    def agrees(self) -> bool:
        """Whether the scenario's own actuator agrees."""
        return self.simulated[0].agrees

    @property
    def printed(self) -> str:
        """The paper's figure with its unit; empty if it prints none."""
        return "" if self.paper is None else f"{self.paper:g} {self.unit}".strip()

    def cells(self) -> dict[str, str]:
        """Its line in a table, by column."""
        return {
            "claim": self.id,
            "statement": self.statement,
            "reason": self.reason,
            "paper": self.printed,
            "simulated": ", ".join(f"{one.actuator} {one.text()}" for one in self.simulated),
            "ratio": "" if self.ratio is None else f"{self.ratio:.2f}",
            "wanted": self.wanted,
            "judgement": self.word,
        }

    def numbers(self) -> Iterator[tuple[Mapping[str, str], Mapping[str, float]]]:
        """The figure of each actuator; one that has no such row gives none."""
        for one in self.simulated:
            if math.isfinite(one.value):
                yield {"claim": self.id, "actuator": one.actuator}, {CLAIMED: one.value}

    def as_dict(self) -> dict[str, object]:
        """Give plain JSON; a figure that does not exist is left out."""
        content = {k: v for k, v in asdict(self).items() if v is not None and k != "simulated"}
        content["answers"] = [one.as_dict() for one in self.simulated]  # their name in report.json
        content["changes"] = [asdict(change) for change in self.changes if math.isfinite(change.value)]
        return content


def judgements(
    claims: Sequence[Claim],
    rows_by_actuator: Mapping[str, Sequence[Row]],
    changes_of: Callable[[Claim], Sequence[Change]] = lambda claim: (),
) -> tuple[ClaimJudgement, ...]:
    """Judge every claim by the rows of every actuator; the first actuator is the scenario's own.

    Parameters
    ----------
    claims : what is claimed
    rows_by_actuator : rows of each actuator
    changes_of : what the figure of a claim that is not met becomes, one factor changed at a time

    Raises InputError where a claim selects no row.
    """
    found = []
    for claim in claims:
        simulated = []
        for actuator, rows in rows_by_actuator.items():
            value = claim.value(rows)
            simulated.append(Simulated(actuator, value, claim.agreement.holds(value, claim.paper)))
        if math.isnan(simulated[0].value):
            raise InputError(f"claim {claim.id}", "selects no row that has this metric; look into rms.csv")
        changes = () if simulated[0].agrees or claim.calibrated else tuple(changes_of(claim))
        said, cause = [_cut(claim, next(iter(rows_by_actuator.values())))], ""
        if not simulated[0].agrees:
            cause, why = _cause(claim, simulated[0].value, changes)
            said += [why, claim.note]
        found.append(
            ClaimJudgement(
                claim.id,
                claim.statement,
                claim.paper,
                claim.unit,
                claim.agreement.words(),
                tuple(simulated),
                _sentences(said),
                claim.calibrated,
                changes,
                cause,
            )
        )
    return tuple(found)


def _sentences(said: Sequence[str]) -> str:
    """Join what there is; the first begins small, as in a cell of a table."""
    first, *others = [text for text in said if text] or [""]
    return ". ".join([first, *(text[0].upper() + text[1:] for text in others)])


def _cut(claim: Claim, rows: Sequence[Row]) -> str:
    """Say that the drive's range cut the voltage in the rows of a claim."""
    cut = max((row.saturated_samples or 0 for row in rows if claim.selects(row)), default=0)
    return f"the reference exceeds the range: the drive cut {cut:g} samples" if cut else ""


def _cause(claim: Claim, value: float, changes: Sequence[Change]) -> tuple[str, str]:
    """The factor that brings the figure nearest to agreement, of several the one that moves it most.

    Gives its name, empty where none explains it, and what every factor makes of the figure.
    """
    known = [change for change in changes if math.isfinite(change.value)]
    if not known:
        return "", ""
    gaps = {change: claim.agreement.gap(change.value, claim.paper) for change in known}
    first, *others = sorted(known, key=lambda change: (gaps[change], -abs(change.value - value)))
    own = claim.agreement.gap(value, claim.paper)
    rest = "; ".join(f"{change.words} {change.value:.3g}" for change in others)
    if gaps[first] > NO_CAUSE * own:
        return "", f"no single factor: {value:.3g}; {first.words} {first.value:.3g}; {rest}".rstrip("; ")
    cause = CAUSES[first.factor]
    enough = "" if gaps[first] == 0.0 else ", not enough alone"
    text = f"{cause}{enough}: {value:.3g}, {first.words} {first.value:.3g}"
    return cause, f"{text} (one at a time: {rest})" if rest else text
