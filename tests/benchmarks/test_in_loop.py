"""Hysteresis in the loop, simulated: the identified mirror against linear dynamics of the same order."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from ratios import Work

from hammerstein.dynamics import LinearBlock, on_grid
from hammerstein.model import HammersteinModel

MIRROR = Path(__file__).parents[2] / "reports" / "measured" / "one_model" / "model.json"
GROUP = "Hysteresis in the loop: the fine steering mirror, 3 x 3"
TIME_S = 1 / 6400.0


def voltages(samples):
    """White noise of the level of the strongest records [V]: every play turns."""
    return 0.3 * np.random.default_rng(0).normal(size=(3, samples))


def linear_of(block, turned):
    """Linear block of the same order: with its blocks of two rows, or turned, with every entry filled."""
    t = (
        np.linalg.qr(np.random.default_rng(1).normal(size=block.A.shape))[0]
        if turned
        else np.eye(len(block.A))
    )
    return LinearBlock(t @ block.A @ t.T, t @ block.B, block.C @ t.T, block.D, block.sample_time_s)


@pytest.mark.parametrize(
    ("against", "turned", "required"), [("modal form", False, 6.0), ("all entries filled", True, 1.0)]
)
def test_the_mirror_against_linear_dynamics_of_its_order(bench, against, turned, required):
    """At most 1 us a sample is what is asked of a processor of today; 0.86 were measured.

    The modal form has five entries a row. The loop has 51 and more in each of its rows, twice in a sample.
    """
    block = on_grid(HammersteinModel.load(MIRROR).dynamics, TIME_S)
    u, linear = voltages(bench.fewer(200_000)), linear_of(block, turned)
    ours, other = (Work(partial(one.respond, u), u.shape[1]) for one in (block, linear))
    what = f"order {len(block.A)}, {block.hysteresis.bank.r.size} plays"
    row = bench.compare(GROUP, what, f"linear block, {against}", ours, other, "<=", required, repeats=5)
    assert row.acceptable
