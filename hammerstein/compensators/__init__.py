"""Compensators: laws from a reference in um to a drive in V.

To add one to the package, write it in a file of its own and name it here.
"""

from hammerstein.compensators.base import (
    COMPENSATORS as COMPENSATORS,
    Compensator as Compensator,
    DecoupledInverse as DecoupledInverse,
    NoCompensation as NoCompensation,
)
from hammerstein.compensators.exact.inverse import ExactInverse as ExactInverse
from hammerstein.compensators.feedback.pid import Feedback as Feedback
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicative as InverseMultiplicative
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverse as HammersteinInverse

for _kind in (
    NoCompensation,
    InverseMultiplicative,
    DecoupledInverse,
    ExactInverse,
    HammersteinInverse,
    Feedback,
):
    COMPENSATORS.register(_kind)
