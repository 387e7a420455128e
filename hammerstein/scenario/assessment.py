"""Assessment of a scenario by expected results, such as those of a publication or a data sheet.

Each kind is a plug-in (``register``, or the entry point group ``hammerstein.blocks``) and a table
``[assessment]`` of a scenario file. Runs, reports and baselines only use the interface below.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, Field
from pydantic_core import PydanticKnownError

from hammerstein.metrics import METRICS, Row
from hammerstein.model import HammersteinModel
from hammerstein.plugins import Family
from hammerstein.runtime.store import Store
from hammerstein.validation import Strict


@dataclass(frozen=True)
class Judgement(ABC):
    """Result of a run for one expected result, as plain values."""

    id: str

    @property
    @abstractmethod
    def agrees(self) -> bool:
        """Whether the result agrees with the expected one."""

    @property
    def word(self) -> str:
        """The verdict in words, for pages and ``report.json``."""
        return "met" if self.agrees else "not met"

    @abstractmethod
    def cells(self) -> dict[str, str]:
        """Cells of its table row, by column."""

    @abstractmethod
    def numbers(self) -> Iterator[tuple[Mapping[str, str], Mapping[str, float]]]:
        """Finite numbers for a baseline: the key of each row, and its numbers by name."""

    @abstractmethod
    def as_dict(self) -> dict[str, object]:
        """Return plain JSON."""


class Assessment(Strict, ABC):
    """The expected results of a scenario, as a frozen value with a tag ``kind``."""

    kind: str
    title: ClassVar[str] = "Judgements"
    """Heading of the table of judgements."""
    number_names: ClassVar[tuple[str, ...]] = ()
    """Names of the numbers of its judgements, for which a scenario may give tolerances."""
    more: ClassVar[str] = ""
    """Sentence below the results of several reports: where their reasons are."""
    reading_first: ClassVar[bool] = False
    """Whether errors of the sensor's reading are stated before those of the true position."""

    @property
    def runs(self) -> int:
        """Upper limit of the additional runs of the scenario that it needs."""
        return 0

    def names(self) -> tuple[str, ...]:
        """Names of the expected results."""
        return ()

    def place(self) -> str:
        """Place of the expected results in their source, such as ``in the data sheet: Fig. 3``, or empty."""
        return ""

    def source(self) -> str:
        """Source of the expected results; empty if there is none."""
        return ""

    def actuators(self) -> tuple[str, ...]:
        """Packaged actuators and model files that it uses: in a file, they stand under ``actuator``."""
        return ()

    @abstractmethod
    def judge(
        self, scenario: Any, name: str, model: HammersteinModel, rows: Sequence[Row], store: Store | None
    ) -> tuple[Judgement, ...]:
        """Judge a run.

        Parameters
        ----------
        scenario, name : the ``Scenario`` that was run, and the name of its report
        model, rows : the simulated actuator and the measured figures
        store : store for the results of further runs

        Raises InputError if the run lacks something that it needs.
        """

    @abstractmethod
    def judgement_of(self, content: Mapping[str, Any]) -> Judgement:
        """Judgement from its stored fields."""

    @classmethod
    def tally(cls, reports: Sequence[Any]) -> list[str]:
        """Summary over several reports, one line each: by default, how many judgements agree."""
        judged = [judgement for report in reports for judgement in report.judgements]
        return [f"{sum(judgement.agrees for judgement in judged)} of {len(judged)} met"]

    @classmethod
    def shipped(cls) -> Mapping[str, Path]:
        """Scenarios and their accepted numbers that it provides: from names in a new folder to files."""
        return {}

    @classmethod
    def prepare(cls, out: Path, page: Path | None, overwrite: bool = False) -> None:
        """Raise InputError for folders into which ``write`` cannot write."""

    @classmethod
    def write(
        cls, reports: Sequence[Any], out: Path, page: Path | None, overwrite: bool = False
    ) -> tuple[Path, ...]:
        """Write a summary of several reports below ``out``; return files that were kept aside.

        Parameters
        ----------
        reports : every ``experiment.report.Report`` of a run, also those without judgements of this kind
        out, page : folder of the reports, and of a page with all figures, if one is wanted
        overwrite : whether to replace files that other programs wrote or a person changed
        """
        return ()


ASSESSMENTS: Family[Assessment] = Family(Assessment, "kind")  # type: ignore[type-abstract]
"""Kinds of assessment; that of the paper is a plug-in, too."""


DEFAULT = "default"
"""Name for all numbers that are not named."""


def _known(name: str) -> str:
    if name not in METRICS:
        raise PydanticKnownError("literal_error", {"expected": ", ".join(map(repr, METRICS))})
    return name


def _known_or_of_a_judgement(name: str) -> str:
    return name if name in (DEFAULT, *numbers_of_judgements()) else _known(name)


def _named(schema: dict[str, Any]) -> None:
    schema["enum"] = list(METRICS)


def numbers_of_judgements() -> list[str]:
    """Names of the numbers of all kinds of judgement."""
    return [name for kind in ASSESSMENTS.kinds.values() for name in kind.number_names]


MetricName = Annotated[str, AfterValidator(_known), Field(json_schema_extra=_named)]
"""Name of a figure of merit, those of plug-ins included."""
NumberName = Annotated[str, AfterValidator(_known_or_of_a_judgement)]
"""Name of a number of a report: a figure of merit, a number of a judgement, or ``default`` for all others."""
