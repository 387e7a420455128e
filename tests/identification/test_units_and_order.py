"""A model does not depend on the units of its records, nor on the order of their axes."""

import numpy as np
import pytest
import theory
from record_cases import plain

from hammerstein.identification.identify import identify
from hammerstein.records.record import Record

T = 1e-3
R = [[[0.0, 0.8, 2.0], [0.0, 1.5]], [[0.0, 1.0], [0.0, 0.6, 1.2]]]
W = [[[3.0, 0.6, 0.5], [0.2, 0.1]], [[-0.15, -0.1], [2.5, 0.7, 0.4]]]


def records(v, um, s, order, samples=480):
    """Two records of two axes behind plays, with noise, one of them to be held back."""
    rng, t = np.random.default_rng(5), T * np.arange(samples)
    for slow, fast in ((4.0, 6.5), (5.1, 7.3)):
        u = np.minimum(1.0, t / 0.1) * np.stack(
            [4.0 * np.sin(2.0 * np.pi * slow * t), 3.5 * np.sin(2.0 * np.pi * fast * t + 0.3)]
        )
        y = theory.prandtl_ishlinskii(u, R, W) + 0.02 * rng.standard_normal((2, samples))
        names = (tuple(own[k] for k in order) for own in ("ab", "xy"))
        yield Record(v * u[order], um * y[order], s * T, *names, source=f"{slow:g} Hz")


def found(asked, v=1.0, um=1.0, s=1.0, order=(0, 1)):
    """What is told of each output, by its name, and what it answers to each input alone."""
    one, held = records(v, um, s, list(order))
    model, fit = identify([one], plain(operators=3, delay_samples=0, **asked), validation=[held])
    u = v * 3.0 * np.sin(np.arange(40) / 5.0)
    alone = [model.hysteresis.respond([u if j == k else 0.0 * u for j in range(2)])[0] / um for k in range(2)]
    judged, errors = fit.validation[fit.kind], model.hysteresis.weight_errors
    told = {}
    for o, name in enumerate(fit.outputs):
        percent, rms_um = judged.nrmse_percent[o], judged.rms_um[o] / um
        sure = np.sort(errors[o]) * v / um if errors else ()
        ways = [alone[k][o] for k in np.argsort(model.inputs)]
        told[name] = np.concatenate([[percent, rms_um, fit.offsets_um[0][o] / um], sure, *ways])
    kinds = fit.kind, fit.invertible, len(fit.flags), [(trial.parameters, trial.told) for trial in fit.trials]
    return kinds, told


@pytest.mark.parametrize(
    "asked",
    [
        {"partition": "fitted"},
        {"solver": "nonnegative", "ridge": 1e-3},
        {"hysteresis": "asymmetric", "dead_zones": 1},
        {"dynamics": "state_space", "order": 2},
    ],
)
def test_records_in_other_units_and_with_their_axes_in_another_order_give_the_same(asked):
    kinds, told = found(asked)
    other_kinds, other = found(asked, 0.125, 4.0, 8.0, (1, 0))
    assert other_kinds == kinds
    for name in "xy":
        np.testing.assert_allclose(other[name], told[name], rtol=1e-5, atol=1e-7, err_msg=name)
