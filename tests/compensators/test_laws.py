"""What every law promises, whatever it does."""

import json

import numpy as np
import pytest
from export_cases import CASES, case, marked

from hammerstein.compensators.base import DecoupledInverseLaw, NoCompensationLaw
from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw
from hammerstein.dynamics import AxesDynamics, Axis, CreepMode
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel

T, K = 50e-6, 1024.0
LAWS = {
    "none": lambda model, limit, *_: NoCompensationLaw(model, limit),
    "inverse_multiplicative": lambda model, limit, v=1.0, s=1.0: InverseMultiplicativeLaw(
        model, limit, s * T
    ),
    "inverse_multiplicative, filter": lambda model, limit, v=1.0, s=1.0: InverseMultiplicativeLaw(
        model, limit, s * T, filter_s=s * 1e-3
    ),
    "decoupled_inverse": lambda model, limit, *_: DecoupledInverseLaw(model, limit),
    "exact_inverse": lambda model, limit, *_: ExactInverseLaw(model, limit),
    "exact_inverse, softened": lambda model, limit, v=1.0, s=1.0: ExactInverseLaw(
        model, limit, softening_v=v * 0.05
    ),
    "hammerstein_inverse": lambda model, limit, v=1.0, s=1.0: HammersteinInverseLaw(model, limit, s * T),
    "hammerstein_inverse, filter": lambda model, limit, v=1.0, s=1.0: HammersteinInverseLaw(
        model, limit, s * T, None, 2000.0 / s
    ),
    "hammerstein_inverse, causal": lambda model, limit, v=1.0, s=1.0: HammersteinInverseLaw(
        model, limit, s * T, 0.0, 2000.0 / s
    ),
}
"""Each of a model, its range, and the units of voltage and time that both are in."""


def model_in(v=1.0, s=1.0, um=1.0, order=(0, 1)):
    """Two resonances with creep and a delay; in other units, and with its axes in another order."""
    table = HammersteinModel.load("duo_bimorph_static").hysteresis
    pairs = [
        [
            Pair(v * one.thresholds_v, um / v * one.weights_um_per_v)
            for one in (table.pairs[o][k] for k in order)
        ]
        for o in order
    ]
    axes = tuple(
        Axis(
            resonance_hz=(280.0, 306.0)[o] / s,
            damping_ratio=(0.12, 0.1)[o],
            creep=(CreepMode(gain=0.05, time_constant_s=0.1 * s),),
        )
        for o in order
    )
    dynamics = AxesDynamics(axes=axes, input_delay_s=2.0 * s * T)
    names = ("a", "b")
    return HammersteinModel("test", PrandtlIshlinskii(pairs), dynamics, v * 10.0, names, names)


@pytest.fixture(scope="module")
def model():
    return model_in()


@pytest.fixture(params=LAWS)
def build(request):
    return LAWS[request.param]


def _path(samples=700):
    """From rest, with minor loops of several sizes and a little noise, back to a rest elsewhere."""
    generator = np.random.default_rng(6)
    time = np.arange(samples) * T
    window = np.clip((time - 2e-3) / 3e-3, 0.0, 1.0) * np.clip((0.03 - time) / 3e-3, 0.0, 1.0)
    angle = 2.0 * np.pi * 150.0 * time
    waves = np.stack([np.sin(angle) + 0.3 * np.sin(7.3 * angle), np.cos(angle) + 0.2 * np.sin(5.1 * angle)])
    return window * (30.0 * waves + 0.01 * generator.normal(size=waves.shape)) + 2.0 * (time > 0.01)


@pytest.mark.parametrize("limit", [10.0, 4.0])
def test_step_by_step_and_in_blocks_it_gives_the_same_bits(model, build, limit):
    law, path = build(model, limit), _path()
    whole, _ = law.respond(path)
    state, one_by_one = law.rest(), np.empty_like(whole)
    for k in range(path.shape[1]):
        one_by_one[:, k], state = law.step(path[:, k], state)
    assert (one_by_one == whole).all()
    first, state = law.respond(path[:, :333])
    rest, _ = law.respond(path[:, 333:], state)
    assert (np.hstack([first, rest]) == whole).all()


@pytest.mark.parametrize(
    "name",
    [marked(export.name) for export in CASES if export.law != "model"],
)
def test_a_step_counts_from_where_the_actuator_starts(name):
    """Working points, starts, more inputs than outputs, dead-zones: a step has the bits of a block."""
    code = case(name).code()
    law, path = code.block, code.adverse(900)
    state, one_by_one = law.rest(), []
    for sample in path.T:
        drive, state = law.step(np.ascontiguousarray(sample), state)
        one_by_one.append(drive)
    assert (np.stack(one_by_one, axis=1) == law.respond(path)[0]).all()


@pytest.mark.parametrize("limit", [10.0, 4.0])
def test_its_state_survives_json(model, build, limit):
    law, path = build(model, limit), _path()
    _, state = law.respond(path[:, :400])
    restored = law.restore(json.loads(json.dumps(state.as_dict())))
    again, _ = law.respond(path[:, 400:], restored)
    straight, _ = law.respond(path[:, 400:], state)
    assert (again == straight).all()


def test_a_state_is_not_changed_by_its_use(model, build):
    law, path = build(model, 10.0), _path()
    _, state = law.respond(path[:, :400])
    before = json.dumps(state.as_dict())
    law.respond(path[:, 400:], state)
    assert json.dumps(state.as_dict()) == before


@pytest.mark.parametrize("limit", [10.0, 4.0])
def test_the_range_is_kept_and_reached(model, build, limit):
    drive, _ = build(model, limit).respond(3.0 * _path())
    assert np.abs(drive).max() == limit
    assert np.abs(build(model, limit).drive_for(3.0 * _path())).max() == limit


def test_a_path_known_ahead_is_aligned_with_its_drive(model, build):
    """A path that begins and ends at rest: the stream's drive, earlier by the preview, to the last bit."""
    law = build(model, 10.0)
    path = np.hstack([np.zeros((2, 200)), _path(), np.tile(_path()[:, -1:], 200)])
    ahead = law.preview_samples
    stream, _ = law.respond(np.hstack([path, np.tile(path[:, -1:], ahead)]))
    assert (law.drive_for(path) == stream[:, ahead:]).all()


def test_bad_references_are_named(model, build):
    law, path = build(model, 10.0), _path()
    path[1, 17] = np.nan
    for use in (law.respond, law.drive_for):
        with pytest.raises(InputError, match="axis 2 is not finite at sample 17"):
            use(path)
        with pytest.raises(InputError, match=r"shape \(1, 5\)"):
            use(np.zeros((1, 5)))


def test_what_must_be_known_before_a_run_is_said(model, build):
    law = build(model, 10.0)
    assert isinstance(law.statement(), str)
    if isinstance(law, (ExactInverseLaw, HammersteinInverseLaw)):
        assert "has an inverse for every reference" in law.statement()


@pytest.mark.parametrize("limit", [400.0, 4.0])
def test_it_does_not_depend_on_units_and_the_order_of_axes(build, limit):
    """In units 1024 times as small; with a range that cuts, and one that does not.

    At one that cuts now and then, a sum in another order may grow: the drive goes from end to end and back.
    """
    path = _path()
    first, _ = build(model_in(), limit).respond(path)
    assert (np.abs(first).max() < limit) == (limit > 10.0)
    in_units, _ = build(model_in(K, K, K), K * limit, K, K).respond(K * path)
    np.testing.assert_array_equal(in_units / K, first)
    crossed, _ = build(model_in(order=(1, 0)), limit).respond(path[::-1])
    np.testing.assert_allclose(crossed[::-1], first, atol=1e-9)


@pytest.mark.full
def test_three_axes():
    generator = np.random.default_rng(1)
    pairs = [
        [
            Pair([0.0, 1.0, 3.0], [4.0, 1.0, 0.5])
            if o == k
            else Pair([0.0, 2.0], generator.normal(0, 0.2, 2))
            for k in range(3)
        ]
        for o in range(3)
    ]
    axes = tuple(Axis(resonance_hz=f, damping_ratio=0.05) for f in (250.0, 300.0, 400.0))
    names = ("a", "b", "c")
    model = HammersteinModel("three", PrandtlIshlinskii(pairs), AxesDynamics(axes=axes), 10.0, names, names)
    law = HammersteinInverseLaw(model, 10.0, T)
    path = np.vstack([_path(), _path()[:1]])[[2, 1, 0]] * [[1.0], [0.5], [0.7]]
    whole, _ = law.respond(path)
    first, state = law.respond(path[:, :200])
    rest, _ = law.respond(path[:, 200:], state)
    assert (np.hstack([first, rest]) == whole).all()
