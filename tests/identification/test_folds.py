"""What is left out in turn."""

import numpy as np
import pytest

from hammerstein.errors import IdentificationError
from hammerstein.identification.static.folds import FOLDS, moments_of_folds


def folds(parts, samples=90):
    generator = np.random.default_rng(1)
    x, y = generator.normal(size=(3, samples)), generator.normal(size=(2, samples))
    return x, y, moments_of_folds([(0, x)], y, 0, 3, parts)


@pytest.mark.parametrize("parts", [2, 3, 9])
def test_folds_together_hold_every_sample_once(parts):
    x, _, found = folds(parts)
    assert len(found) == min(parts, FOLDS)
    assert sum(m.samples for m in found.values()) == x.shape[1]


def test_one_part_leaves_nothing_to_choose_by():
    with pytest.raises(IdentificationError, match="too short to choose"):
        folds(1)
