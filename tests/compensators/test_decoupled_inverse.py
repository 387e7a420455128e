import numpy as np
import pytest

from hammerstein.compensators.base import DecoupledInverseLaw, inverse_pair
from hammerstein.errors import SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel

# Check pair of reference 20 of the paper.
R = [0.0, 0.45, 0.9, 1.35, 1.8, 2.25, 2.7]
W = [0.72, 0.6, 0.48, 0.36, 0.24, 0.12, 0.012]


def test_check_pair():
    inverse = inverse_pair(Pair(R, W))
    np.testing.assert_allclose(inverse.thresholds_v, [0, 0.324, 0.918, 1.728, 2.7, 3.78, 4.914], atol=1e-9)
    expected = [1.3889, -0.6313, -0.2020, -0.0926, -0.0463, -0.0198, -0.0019]
    np.testing.assert_allclose(inverse.weights_um_per_v, expected, atol=5e-5)


def test_check_pair_output():
    t = np.linspace(0.0, 2.0, 8001)
    y, _ = PrandtlIshlinskii(((Pair(R, W),),)).respond([4 * np.sin(2 * np.pi * t)])
    assert np.abs(y).max() == pytest.approx(
        0.72 * 4 + sum(w * (4 - r) for r, w in zip(R[1:], W[1:], strict=True))
    )
    assert np.abs(y).max() == pytest.approx(8.2056, abs=5e-4)


def test_inverse_of_one_axis_is_exact_with_the_jump():
    rng = np.random.default_rng(0)
    table = HammersteinModel.load("duo_bimorph_static")
    from dataclasses import replace

    (xx, _), (_, yy) = table.hysteresis.pairs
    alone = replace(table, hysteresis=PrandtlIshlinskii(((xx, Pair.absent()), (Pair.absent(), yy))))
    walk = np.cumsum(rng.normal(size=(2, 3000)), axis=1)
    reference = 40.0 * np.sin(0.2 * walk)
    law = DecoupledInverseLaw(alone, np.inf)
    drive, _ = law.respond(reference)
    position, _ = alone.hysteresis.respond(drive)
    np.testing.assert_allclose(position, reference, atol=1e-9)
    np.testing.assert_allclose(law.jump_v, [0.07, 0.07])


def test_cross_couplings_stay_as_they_were():
    table = HammersteinModel.load("duo_bimorph_static")
    angle = 2 * np.pi * 50.0 * 50e-6 * np.arange(1600)
    reference = np.stack([50.0 * np.sin(angle), np.zeros(1600)])
    drive, _ = DecoupledInverseLaw(table, np.inf).respond(reference)
    position, _ = table.hysteresis.respond(drive)
    coupled, _ = table.hysteresis.respond(np.stack([drive[0], np.zeros(1600)]))
    np.testing.assert_allclose(position[1], coupled[1], atol=0.2)
    assert np.ptp(position[1, 800:]) > 3.0


def test_a_slope_below_zero_is_refused_with_its_threshold():
    with pytest.raises(SimulationError, match=r"slope is -0\.5 um/V when 2 operators move \(threshold 1 V\)"):
        inverse_pair(Pair([0.0, 1.0], [1.0, -1.5]))
