"""Compensators: laws from a reference in um to a drive in V.

To add one to the package, write it in a file of its own and name it here.
"""

from hammerstein.compensators.base import COMPENSATORS as COMPENSATORS, Compensator as Compensator
from hammerstein.compensators.exact import other_kinds  # noqa: F401  # register inverses
from hammerstein.compensators.exact.inverse import ExactInverse as ExactInverse
from hammerstein.compensators.feedback.pid import Feedback as Feedback
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicative as InverseMultiplicative
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverse as HammersteinInverse
from hammerstein.compensators.simple_laws import (
    DecoupledInverse as DecoupledInverse,
    NoCompensation as NoCompensation,
)

for _kind in (
    NoCompensation,
    InverseMultiplicative,
    DecoupledInverse,
    ExactInverse,
    HammersteinInverse,
    Feedback,
):
    COMPENSATORS.register(_kind)
