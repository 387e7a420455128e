"""The true error lies in the stated band: a small sample; all kinds and seeds by ``python -m``."""

import pytest

from coverage_of_bands.seeds import KINDS, found

SEEDS = 8
FEWEST = 5
"""Of 8 bands that hold nine tenths of the errors, fewer than 5 hold theirs once in 200 times."""


@pytest.mark.full
@pytest.mark.parametrize(
    "kind",
    [kind for kind in KINDS if not kind.dynamic and kind.hysteresis not in ("rate_dependent", "generalised")],
    ids=lambda k: k.name,
)
def test_the_true_error_lies_in_the_band(kind):
    covered = [found(kind, seed).covered for seed in range(SEEDS)]
    assert sum(covered) >= FEWEST, covered


@pytest.mark.full
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.dynamic][:1], ids=lambda k: k.name)
def test_the_true_error_lies_in_the_band_behind_an_axis(kind):
    covered = [found(kind, seed).covered for seed in range(SEEDS)]
    assert sum(covered) >= FEWEST, covered
