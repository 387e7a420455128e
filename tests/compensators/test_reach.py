import re

import numpy as np
import pytest
import theory

from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw
from hammerstein.compensators.reach import reach, shortfall
from hammerstein.dynamics import AxesDynamics, Axis, StaticDynamics
from hammerstein.hysteresis import Pair, Parallel, PrandtlIshlinskii
from hammerstein.model import HammersteinModel

T = 50e-6
NAMES = (("u", "v"), ("x", "y"))


def _table(dynamics=None):
    hysteresis = PrandtlIshlinskii.from_arrays(theory.R_V, theory.W_UM_PER_V)
    return HammersteinModel("table", hysteresis, dynamics or StaticDynamics(n_outputs=2), 10.0, *NAMES)


@pytest.mark.full
@pytest.mark.parametrize("axes", [1, 2])
def test_a_kind_without_inverse_reaches_as_far(axes):
    """The same plays in two blocks side by side, which have no exact inverse; not about the rest voltage."""
    range_v, weights = (-2.0, 12.0), np.asarray(theory.W_UM_PER_V)[:axes, :axes]
    half, table = (PrandtlIshlinskii.from_arrays(theory.R_V, part * weights) for part in (0.5, 1.0))
    dynamics, names = StaticDynamics(n_outputs=axes), [names[:axes] for names in NAMES]
    whole, found = (
        reach(HammersteinModel("reach", block, dynamics, 10.0, *names), range_v)
        for block in (table, Parallel((half, half)))
    )
    size = np.ptp(whole.alone_um, axis=1).min()
    np.testing.assert_allclose(found.alone_um, whole.alone_um, atol=0.01 * size)
    np.testing.assert_allclose(found.together_um, whole.together_um, atol=0.01 * size)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_reach_has_its_units_and_goes_with_its_outputs(order):
    def found(v, um, order):
        pairs = [[Pair(v * theory.R_V, um / v * theory.W_UM_PER_V[o][k]) for k in order] for o in order]
        names = [[own[k] for k in order] for own in NAMES]
        model = HammersteinModel("m", PrandtlIshlinskii(pairs), StaticDynamics(n_outputs=2), v * 10.0, *names)
        return reach(
            model, [(v * low, v * high) for low, high in np.array([(-3.0, 9.0), (-8.0, 5.0)])[order]]
        )

    first, other = found(1.0, 1.0, [0, 1]), found(1024.0, 4096.0, order)
    for one, two in ((first.alone_um, other.alone_um), (first.together_um, other.together_um)):
        np.testing.assert_allclose(two[order] / 4096.0, one, rtol=1e-6)


def _tips(range_v):
    """Settled loop amplitudes (output, input), from the closed form."""
    return np.array(
        [[theory.loop_amplitude(theory.R_V, w, range_v) for w in row] for row in theory.W_UM_PER_V]
    )


def test_one_axis_reaches_the_tip_of_its_settled_loop():
    model = HammersteinModel(
        "one",
        PrandtlIshlinskii([[Pair(theory.R_V, theory.W_XX)]]),
        StaticDynamics(n_outputs=1),
        10.0,
        ("u",),
        ("x",),
    )
    expected = theory.loop_amplitude(theory.R_V, theory.W_XX, 10.0)
    assert reach(model, 10.0).alone_um[0] == pytest.approx([-expected, expected], rel=1e-9)


def test_coupled_axes_reach_what_their_tips_say():
    """Alone, the other axis is held against the coupling; together, both inputs push with the worst signs."""
    found = reach(_table(), 10.0)
    tips = _tips(10.0)
    alone = np.diag(tips) - np.abs(tips[[0, 1], [1, 0]] * tips[[1, 0], [0, 1]] / np.diag(tips)[::-1])
    np.testing.assert_allclose(found.alone_um, np.stack([-alone, alone], axis=1), rtol=0.01)
    worst = np.diag(tips) - np.abs(tips[[0, 1], [1, 0]])
    assert (np.abs(found.together_um) < np.abs(found.alone_um)).all()
    assert (np.abs(found.together_um) >= 0.97 * worst[:, None]).all()
    assert "x -5" in found.statement(("x", "y"))


def test_reach_is_what_the_inverse_just_reaches():
    model = _table()
    law = ExactInverseLaw(model, 10.0)
    wave = np.sin(2.0 * np.pi * np.arange(1000) / 200)
    for tip in np.diag(reach(model, 10.0).alone_um[:, 1]):
        assert np.abs(law.drive_for(0.999 * np.outer(tip, wave))).max() < 10.0
        assert np.abs(law.drive_for(1.001 * np.outer(tip, wave))).max() == 10.0


def test_all_corners_of_what_is_reached_together_are_reached():
    """Both couplings are positive: it is the corner where the axes go opposite ways that asks for most."""
    model = _table()
    law = ExactInverseLaw(model, 10.0)
    wave = np.sin(2.0 * np.pi * np.arange(1000) / 200)
    size = reach(model, 10.0).together_um[:, 1]
    drives = {
        (scale, sign): np.abs(law.drive_for(scale * np.outer(size * [1.0, sign], wave))).max()
        for scale in (0.999, 1.001)
        for sign in (1.0, -1.0)
    }
    assert max(drives[0.999, sign] for sign in (1.0, -1.0)) < 10.0
    assert max(drives[1.001, sign] for sign in (1.0, -1.0)) == 10.0


def test_without_limit_the_reach_has_none():
    assert np.isinf(reach(_table(), np.inf).alone_um).all()


def test_shortfall_names_samples_and_axes():
    model = _table()
    law = ExactInverseLaw(model, 10.0)
    angle = 2.0 * np.pi * np.arange(800) / 400
    path = np.stack([70.0 * np.sin(angle), 20.0 * np.sin(angle)])
    drive = law.drive_for(path)
    found = shortfall(model, law, path, drive, T)
    np.testing.assert_allclose(
        found.predicted_um,
        theory.prandtl_ishlinskii(drive, [[theory.R_V] * 2] * 2, theory.W_UM_PER_V),
        atol=1e-9,
    )
    np.testing.assert_allclose(found.error_um, found.predicted_um - path, atol=1e-12)
    assert (np.abs(found.error_um).max(axis=1) > 1e-6).tolist() == [True, False]
    first, number = int(np.argmax(found.at_range[0])), int(found.at_range[0].sum())
    assert (
        f"u is at its upper limit, 10 V, in {number} of 800 samples, first at {first * T:.4g} s; "
        in found.statement(*NAMES)
    ) == (2 * (drive[0] >= 10.0).sum() >= number)
    assert "output x has an error of up to" in found.statement(*NAMES)


def test_times_count_from_the_path_and_not_from_its_lead_in():
    model, law = _table(), ExactInverseLaw(_table(), 10.0)
    path = np.stack([np.r_[np.linspace(0.0, 80.0, 100), np.full(100, 20.0)], np.zeros(200)])
    found = shortfall(model, law, path, law.drive_for(path), T)
    first = int(np.argmax(found.at_range[0]))
    assert f"first at {first * T:.4g} s" in found.statement(*NAMES)
    assert f"first at {10 * T:.4g} s" in found.statement(*NAMES, lead=first - 10)
    assert "first in the lead-in" in (said := found.statement(*NAMES, lead=120))
    assert "um in the lead-in" in said


def test_a_path_within_reach_passes():
    model = _table(AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.12),) * 2))
    law = HammersteinInverseLaw(model, 10.0, T, preview_s=0.0)
    path = np.zeros((2, 800))
    path[0] = 20.0 * np.sin(2.0 * np.pi * 50.0 * T * np.arange(800)) ** 5
    found = shortfall(model, law, path, law.drive_for(path), T)
    assert found.complete
    assert np.abs(found.error_um).max() < 0.01  # the stated delay is no error


def test_a_jump_is_pointed_out():
    model = _table(AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.12),) * 2))
    law = HammersteinInverseLaw(model, 10.0, T)
    path = np.zeros((2, 600))
    path[1, 300:] = 10.0
    found = shortfall(model, law, path, law.drive_for(path), T)
    assert re.search(r"largest acceleration is at 0.01(495|5) s on y\.", found.statement(*NAMES))
