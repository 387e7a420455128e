"""Base class of compensators: options, and the design of a law for a model and a drive."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

from hammerstein.blocks.driving import RangeLike
from hammerstein.plugins import Family
from hammerstein.validation import Strict

if TYPE_CHECKING:
    from hammerstein.blocks import Controller, Law, Learner
    from hammerstein.model import HammersteinModel


class Compensator(Strict, ABC):
    """Options of a compensator, as in a scenario: frozen, without unknown keys.

    To add one, derive from this class, give it a field ``law: Literal["its name"]`` with that default, and
    register it.
    """

    if TYPE_CHECKING:  # a field of every kind, behind its others
        law: str

    static: ClassVar[bool] = False
    """Whether its law takes the dynamics of a model for none."""

    @abstractmethod
    def design(
        self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float
    ) -> Law[Any] | Controller[Any] | Learner:
        """Build the law.

        Parameters
        ----------
        model : model of the actuator
        range_v : range of the drive [V], see ``DriveRange.of``
        sample_time_s : time between samples [s]

        Raises
        ------
        InputError : options that do not fit the model
        SimulationError : a law that cannot work
        """


COMPENSATORS: Family[Compensator] = Family(Compensator, "law")  # type: ignore[type-abstract]
