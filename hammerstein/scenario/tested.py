"""A compensator as a scenario tests it: its options, a label, and where its model comes from."""

from __future__ import annotations

import sys
from functools import cache
from typing import Annotated

from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.compensators.learning import Learned  # noqa: F401  (a kind of compensator that registers itself)
from hammerstein.scenario.source import ModelSource


class TestedCompensator(ModelSource, Compensator):
    """A compensator with its label and the source of its model."""

    __test__ = False  # no test, whatever pytest thinks of its name


@cache
def _tested(kind: type[Compensator]) -> type[Compensator]:
    name = f"Tested{kind.__name__}"
    body = {"__doc__": kind.__doc__, "__module__": kind.__module__, "__test__": False}
    twin = type(name, (TestedCompensator, kind), body)
    setattr(sys.modules[kind.__module__], name, twin)  # where another process looks for it
    return twin


Tested = Annotated[TestedCompensator, COMPENSATORS.field(_tested)]
"""Any compensator, chosen by its law."""
