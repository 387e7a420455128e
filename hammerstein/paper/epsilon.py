"""The paper's error measure of a path of two axes (section 5.4), as printed."""

from __future__ import annotations

import numpy as np

from hammerstein.arrays import Array
from hammerstein.metrics import Measured, metric, worst
from hammerstein.metrics.metric import Values


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
