"""Parameters of an axis behind hysteresis of another law than that of the model: their stated errors."""

import made_up
import numpy as np
import pytest
from random_actuators.truth import Actuator, law

from hammerstein.identification.identify import identify
from hammerstein.identification.parameter_covariance import moved_beside_other_laws
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record

RATE_HZ = 2000.0
LAG_S = 1.2e-3


def test_a_parameter_moves_back_by_what_it_took_up():
    """Theory of omitted variables: S alone takes up b (S E) / (S S) of another column E."""
    g = np.random.default_rng(0)
    kept, moved, other = g.standard_normal((3, 4000))
    moved, other = moved + 0.5 * kept, other + 0.4 * moved
    rows = np.vstack([kept, moved])
    y = 3.0 * kept + 2.0 * moved + 0.7 * other + 0.01 * g.standard_normal(4000)
    found, *_ = np.linalg.lstsq(rows.T, y, rcond=None)
    left = y - found @ rows
    assert found[1] - 2.0 == pytest.approx(0.7 * 0.4, rel=0.1)
    noise = float(np.mean(left**2))
    change = moved_beside_other_laws(moved[None], kept[None], other[None], left, np.ones(1), noise, noise)
    assert found[1] + change[0] == pytest.approx(2.0, abs=0.005)


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param("envelope", 5, marks=pytest.mark.full),
        pytest.param("relays", 10, marks=pytest.mark.full),
        ("bouc_wen", 1),
    ],
)
def test_a_low_pass_behind_another_law_is_within_two_of_its_standard_errors(name, seed):
    g = np.random.default_rng(seed)
    nothing = np.zeros((1, 1)), np.zeros((1, 1, 1))
    truth = Actuator(
        *nothing, 0.0, 100.0, RATE_HZ,
        lag_s=LAG_S, noise_um=0.002, laws=((law(name, g),),), gains_um=np.array([[20.0]]),
    )  # fmt: skip
    sent = [made_up.wander(truth, g, 2.0, 1.0, 60.0, share=share) for share in (0.9, 0.6, 0.3)]
    records = [Record(u, truth.record(u, g), 1.0 / RATE_HZ, source=f"{i}") for i, u in enumerate(sent)]
    settings = Settings(
        operators=10, partition="voltage", dynamics="lag", creep_modes=0, delay_samples=0, error_curve=False
    )
    _, fit = identify(records, settings)
    [one] = fit.axes
    error_s = 0.01 * one.lag_error_percent * one.axis.lag_s
    assert abs(one.axis.lag_s - LAG_S) < 2.0 * error_s
    assert error_s < 0.3 * LAG_S
