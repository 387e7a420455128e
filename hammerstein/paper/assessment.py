"""Assessment by the paper: error measure, figure and claims, and the actuators that they are tested for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from hammerstein.arrays import Array
from hammerstein.errors import HammersteinError
from hammerstein.metrics import Measured, Row, Values, metric, worst
from hammerstein.model import HammersteinModel
from hammerstein.paper.claims import Claim
from hammerstein.paper.judgements import CLAIMED, Change, ClaimJudgement, Simulated, judgements
from hammerstein.plugins import register
from hammerstein.quantities import FileName, Trial
from hammerstein.runtime.store import Store
from hammerstein.scenario.assessment import Assessment
from hammerstein.validation import Strict

if TYPE_CHECKING:
    from hammerstein.experiment.report import Report
    from hammerstein.scenario import Scenario


def epsilon(reference: Array, position: Array) -> Array:
    """The measure at every sample (sample,) of a position (2, sample) against a reference [um].

        eps = sgn(theta) sqrt|theta|,   theta = (x_r + y_r)^2 - (x + y)^2

    It turns a small error into a large value where x_r + y_r is large; judge paths by the error per axis.
    """
    theta = reference.sum(axis=0) ** 2 - position.sum(axis=0) ** 2
    return np.asarray(np.sign(theta) * np.sqrt(np.abs(theta)))


@metric(
    "largest absolute value of the paper's error measure, as printed: sgn(theta) sqrt(|theta|) with "
    "theta = (x_r + y_r)^2 - (x + y)^2 [um]. It magnifies small errors where x_r + y_r is large: at "
    "50 um, an error of 0.1 um gives several um. It cannot be the quantity that the paper plots; "
    "judge a path by the error of each axis, the distance and the radius",
    asked_by="paper",
    heading="epsilon (see below)",
)
def epsilon_max_um(m: Measured) -> Values:
    """Largest measure of the reading, counted from the middle of the path; None if it has not two axes."""
    if m.reference_um is None or len(m.reference_um) != 2:
        return None
    middle = m.middle[:, None]
    return worst(epsilon(m.reference_um - middle, m.reading_um - middle))


PAPER = (
    "Multivariable classical Prandtl-Ishlinskii hysteresis modeling and compensation and sensorless control "
    "of a nonlinear 2-dof piezoactuator"
)


class AlsoOn(Strict):
    """Another actuator that the claims are asked of, by the same scenario."""

    actuator: FileName = Field(description="packaged actuator or model file")


@register
class Paper(Assessment):
    """Claims of the paper, and criteria of agreement."""

    kind: Literal["paper"]
    title: ClassVar[str] = "Claims of the paper"
    number_names: ClassVar[tuple[str, ...]] = (CLAIMED,)
    more: ClassVar[str] = (
        "Claims that an actuator was fitted to are not counted. "
        "The paper gives a bandwidth of 400 to 500 Hz and no damping. The scenarios take it for the "
        "frequency at which the gain has risen by 3 dB, with small damping and a sensor without lag: the "
        "paper's own figures support that. With the literal reading, -3 dB, no damping follows the 50 um "
        "circle as closely as the paper shows. All readings: reports/paper/readings/README.md in the source "
        "of the package."
    )
    reading_first: ClassVar[bool] = True  # as the paper's figures show it

    figure: str = Field(default="", description='simulated figure of the paper, such as "Fig. 9"')
    claims: tuple[Claim, ...] = Field(default=(), description="claims of the paper about it")
    also_on: tuple[AlsoOn, ...] = Field(default=(), description="other actuators, for comparison")
    seeds: Trial = Field(default=1, description="seeds of noise, for each of which every claim is tested")
    finer: tuple[Trial, ...] = Field(
        default=(),
        description=(
            "divisors of the sample time, for each of which every claim is tested too, such as [2, 4]"
        ),
    )

    @property
    def runs(self) -> int:
        """Every repeat on every actuator, and one on every other actuator."""
        return (1 + len(self.also_on)) * (self.seeds + len(self.finer)) - 1

    def names(self) -> tuple[str, ...]:
        """Name of every claim."""
        return tuple(claim.id for claim in self.claims)

    def place(self) -> str:
        """The figure."""
        return f"in the paper: {self.figure}" if self.figure else ""

    def source(self) -> str:
        """Title of the paper."""
        return PAPER

    def actuators(self) -> tuple[str, ...]:
        """The other actuators."""
        return tuple(other.actuator for other in self.also_on)

    def judge(
        self, scenario: Scenario, name: str, model: HammersteinModel, rows: Sequence[Row], store: Store | None
    ) -> tuple[ClaimJudgement, ...]:
        """Judge every claim on every actuator, with the cause where the scenario's own does not agree."""
        from hammerstein.paper.causes import Repeats, changes_of, rows_needed

        repeats = Repeats(self.seeds, self.finer)

        def repeated(model: HammersteinModel) -> Iterator[Sequence[Row]]:
            for repeat in repeats.of(scenario, model) if self.claims else ():
                try:
                    yield rows_needed(repeat, self.claims, name, model, store)
                except HammersteinError:  # the law cannot run so
                    yield ()

        known = {model.name: [rows, *repeated(model)]}
        for other in self.also_on if self.claims else ():
            found = HammersteinModel.load(other.actuator)
            known[found.name] = [rows_needed(scenario, self.claims, name, found, store), *repeated(found)]
        return judgements(
            self.claims, known, lambda claim: tuple(changes_of(scenario, model, claim, repeats, store))
        )

    def judgement_of(self, content: Mapping[str, Any]) -> ClaimJudgement:
        """A judgement from the fields that were kept of it."""
        simulated = tuple(Simulated(**one) for one in content["simulated"])
        changes = tuple(Change(**change) for change in content["changes"])
        return ClaimJudgement(**{**content, "simulated": simulated, "changes": changes})

    @classmethod
    def tally(cls, reports: Sequence[Report]) -> list[str]:
        """A line each reading of the paper: how many of the counted claims hold."""
        from hammerstein.paper.page import readings_of

        return [f"{r.actuator}{f' ({r.words})' if r.words else ''}: {r.text()}" for r in readings_of(reports)]

    @classmethod
    def shipped(cls) -> Mapping[str, Path]:
        """Every scenario of this project, and its baseline."""
        return _shipped("shipped/scenarios", "*.toml", "scenarios", "") | _shipped(
            "shipped/baseline", "*.json", "reports/baseline", "reports/baseline/"
        )

    @classmethod
    def prepare(cls, out: Path, page: Path | None, overwrite: bool = False) -> None:
        """Refuse folders that hold other people's files under these names."""
        from hammerstein.paper.page import CLAIMS, CLAIMS_FILE, PAGE, PAGE_FILE
        from hammerstein.runtime.staging import prepare

        prepare(out, CLAIMS, [CLAIMS_FILE], overwrite)
        if page is not None:
            prepare(page, PAGE, [PAGE_FILE], overwrite)

    @classmethod
    def write(
        cls, reports: Sequence[Report], out: Path, page: Path | None, overwrite: bool = False
    ) -> tuple[Path, ...]:
        """Write ``claims.csv`` beside the reports and, where it is wanted, the page of all figures."""
        from hammerstein.paper.page import write_claims, write_page

        kept = write_claims(reports, out, overwrite)
        return kept if page is None else kept + write_page(reports, out, page, overwrite)


def _shipped(name: str, pattern: str, checkout: str, target: str) -> dict[str, Path]:
    """Files that stand in the room once it is installed, and beside the package in its source."""
    room = Path(__file__).parent
    folder = room / name
    found = (folder if folder.is_dir() else room.parents[1] / checkout).glob(pattern)
    return {f"{target}{path.name}": path for path in sorted(found)}
