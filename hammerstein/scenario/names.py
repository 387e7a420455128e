"""Names of numbers as a scenario may give them: figures of merit, and numbers of judgements."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, Field
from pydantic_core import PydanticKnownError

from hammerstein.metrics import METRICS
from hammerstein.scenario.assessment import ASSESSMENTS

DEFAULT = "default"
"""Stands for every number that is not named."""


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
