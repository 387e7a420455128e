import re

import control
import numpy as np
import pytest
import theory_linear

from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw
from hammerstein.compensators.preview.linear_inverse import linear_inverse, low_pass_taps
from hammerstein.dynamics import AxesDynamics, Axis, CreepMode, StateSpaceDynamics, StaticDynamics, discretise
from hammerstein.errors import InputError, SimulationError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel
from hammerstein.quantities import interval

T = 50e-6
S = control.tf("s")
W = 2.0 * np.pi * 300.0
RESONANT = W**2 / (S**2 + 0.2 * W * S + W**2)


def _axes(*resonances, damping=0.12, delay=0, creep=()):
    axes = tuple(Axis(resonance_hz=f, damping_ratio=damping, creep=creep) for f in resonances)
    return AxesDynamics(axes=axes, input_delay_s=delay * T)


def _of(transfer):
    return StateSpaceDynamics.of(control.tf2ss(transfer))


def _coupled():
    """Two resonant axes behind a constant mixing matrix."""
    axis = control.tf2ss(RESONANT)
    return StateSpaceDynamics.of(control.append(axis, axis) * np.array([[1.0, 0.2], [-0.3, 1.0]]))


def _model(dynamics):
    """One or two hysteretic axes, coupled by the hysteresis where there are two."""
    direct, cross = Pair([0.05, 0.4, 2.0, 5.0], [4.0, 0.5, 1.0, 1.5]), Pair([0.05, 1.0], [0.3, -0.1])
    p = dynamics.n_outputs
    rows = tuple(tuple(direct if o == k else cross for k in range(p)) for o in range(p))
    names = ("u", "v")[:p], ("x", "y")[:p]
    return HammersteinModel("test", PrandtlIshlinskii(rows), dynamics, 10.0, *names)


def _position(model, drive):
    return discretise(model.dynamics, T).respond(model.hysteresis.respond(drive)[0])[0]


def _smooth(time_s, length_s):
    x = np.clip(time_s / length_s, 0.0, 1.0)
    return x**4 * (35.0 - 84.0 * x + 70.0 * x**2 - 20.0 * x**3)


def _circle(frequency_hz, radius, samples, axes=2):
    time_s = np.arange(samples) * T
    angle = 2.0 * np.pi * frequency_hz * time_s
    return radius * _smooth(time_s, 0.03) * np.stack([np.sin(angle), np.cos(angle)])[:axes]


DYNAMICS = {
    "resonant": (_axes(280.0, 306.0), 1e-9),
    "hardly damped": (_axes(280.0, 306.0, damping=1e-3), 1e-9),
    "input delay": (_axes(280.0, 306.0, delay=7), 1e-9),
    "a quarter of a sample": (_axes(280.0, 306.0, delay=0.25), 1e-6),
    "a sample and a half": (_axes(280.0, 306.0, delay=1.5), 1e-6),
    "nearly two samples": (_axes(280.0, 306.0, delay=1.9), 1e-6),
    "creep": (_axes(280.0, creep=(CreepMode(gain=0.1, time_constant_s=3.0),)), 1e-9),
    "zero in the right half plane": (_of(RESONANT * (1.0 - S / 2000.0)), 1e-6),
    "sampling zero outside": (_of(RESONANT * W / (S + W)), 1e-6),
    "two sampling zeros": (_of(RESONANT * RESONANT), 1e-6),
    "static": (StaticDynamics(n_outputs=2), 1e-9),
    "coupled": (_coupled(), 1e-8),
}


@pytest.mark.parametrize("name", DYNAMICS)
@pytest.mark.parametrize("frequency_hz", [50.0, 420.0])
def test_stands_on_the_path_on_every_sample(name, frequency_hz):
    dynamics, bound = DYNAMICS[name]
    model = _model(dynamics)
    path = _circle(frequency_hz, 20.0, 1600, dynamics.n_outputs)
    drive = HammersteinInverseLaw(model, 10.0, T).drive_for(path)
    error = np.abs(_position(model, drive) - path)[
        :, :-60
    ]  # the path ends within what some blocks look ahead
    assert np.abs(drive[:, :-60]).max() < 10.0
    assert error[:, 400:].max() < bound
    assert error.max() < 2e-3  # the start, from rest


@pytest.mark.parametrize("frequency_hz", [50.0, 420.0])
def test_between_the_samples_only_the_steps_of_the_hold_are_left(frequency_hz):
    model = _model(_axes(280.0))
    path = _circle(frequency_hz, 20.0, 1600, 1)
    v, _ = model.hysteresis.respond(HammersteinInverseLaw(model, 10.0, T).drive_for(path))
    fine = T / 20.0
    time_s = np.arange(v.shape[1] * 20) * fine
    system = control.c2d(model.dynamics.system(), fine, "zoh")
    position = control.forced_response(system, time_s, np.repeat(v[0], 20)).outputs
    angle = 2.0 * np.pi * frequency_hz * time_s
    error = position - 20.0 * _smooth(time_s, 0.03) * np.sin(angle)
    # A held input of amplitude V acts like itself and images at the sample rate 1/T +- f, of V f T each.
    gain = abs(theory_linear.second_order(frequency_hz, 280.0, 0.12))
    image = abs(theory_linear.second_order(1.0 / T - frequency_hz, 280.0, 0.12))
    assert np.abs(error[20 * 800 : -20]).max() < 3.0 * 20.0 / gain * frequency_hz * T * image + 1e-6


def test_preview_is_one_sample_for_a_resonant_axis_and_stated_for_others():
    assert HammersteinInverseLaw(_model(_axes(280.0)), 10.0, T).preview_samples == 1
    assert HammersteinInverseLaw(_model(_axes(280.0, delay=3)), 10.0, T).preview_samples == 4
    assert HammersteinInverseLaw(_model(StaticDynamics(n_outputs=1)), 10.0, T).preview_samples == 0
    law = HammersteinInverseLaw(_model(_of(RESONANT * (1.0 - S / 2000.0))), 10.0, T)
    # What a zero at exp(T 2000/s) wants of the future halves every ln 2 / (2000 T) samples.
    assert 100 < law.preview_samples < 300
    assert f"looks {law.preview_samples} samples ahead" in law.statement()
    assert "1 zeros outside the unit circle (the slowest at |z| = 1.105)" in law.statement()


@pytest.mark.parametrize("known", [1, 2, 3])
def test_the_statement_counts_samples_of_preview(known):
    law = HammersteinInverseLaw(_model(_axes(280.0)), 10.0, T, preview_s=known * T, filter_hz=1000.0)
    counted = "1 sample" if known == 1 else f"{known} samples"
    assert f"the law needs the reference {counted} ahead ({1e6 * known * T:.4g} us)" in law.statement()
    assert f"the position is {interval((law.needed_samples - known) * T)} late" in law.statement()


def test_gain_of_the_inverse_is_large_above_the_resonance():
    bands = linear_inverse(_axes(280.0), T).large_gain_hz
    square = np.roots([1.0, 4.0 * 0.12**2 - 2.0, 1.0 - 100.0]).max()  # |G|^-2 = (1-q)^2 + 4 z^2 q = 10^2
    assert len(bands) == 1
    assert bands[0][0] == pytest.approx(280.0 * np.sqrt(square), rel=0.01)
    assert bands[0][1] > 9990.0


def test_without_preview_the_position_follows_by_the_stated_delay():
    model = _model(_axes(280.0, 306.0, delay=2))
    path = _circle(50.0, 20.0, 1600)
    law = HammersteinInverseLaw(model, 10.0, T, preview_s=0.0, filter_hz=2000.0)
    assert law.preview_samples == 0
    assert law.delay_samples == 3 + len(law.taps) // 2
    assert law.delay_s == pytest.approx(law.delay_samples * T)
    assert f"{interval(law.delay_s)} late" in law.statement()
    position = _position(model, law.drive_for(path))
    late = law.delay_samples
    assert np.abs(position[:, 800:] - path[:, 800 - late : -late]).max() < 0.01
    half = HammersteinInverseLaw(model, 10.0, T, preview_s=2 * T)
    assert (half.preview_samples, half.delay_samples) == (2, 1)


def test_creep_is_undone_for_minutes():
    modes = (CreepMode(gain=0.05, time_constant_s=3.0), CreepMode(gain=0.05, time_constant_s=300.0))
    model = _model(_axes(280.0, creep=modes))
    step = 1e-3  # a coarse grid is enough for a slow path
    time_s = np.arange(round(120.0 / step)) * step
    path = 20.0 * _smooth(time_s, 0.5)[None] + 5.0 * np.sin(2.0 * np.pi * time_s) * _smooth(time_s, 0.5)
    late = time_s > 1.0

    def drift(law):
        v, _ = model.hysteresis.respond(law.drive_for(path))
        return np.abs(discretise(model.dynamics, step).respond(v)[0] - path)[:, late].max()

    assert drift(HammersteinInverseLaw(model, 10.0, step)) < 1e-6
    assert drift(ExactInverseLaw(model, 10.0)) > 1.0


def test_filter_passes_and_stops_where_it_says():
    law = HammersteinInverseLaw(_model(_axes(280.0)), 10.0, T, filter_hz=1000.0)
    offset = np.arange(len(law.taps)) - len(law.taps) // 2

    def gain(f):
        return float(law.taps @ np.cos(2.0 * np.pi * f * T * offset))

    np.testing.assert_allclose(law.taps, law.taps[::-1], atol=1e-15)
    assert gain(0.0) == pytest.approx(1.0, abs=1e-12)
    assert max(abs(gain(f) - 1.0) for f in np.linspace(0.0, 700.0, 50)) < 1e-3
    assert gain(1000.0) == pytest.approx(0.5, abs=1e-3)
    assert max(abs(gain(f)) for f in np.linspace(1300.0, 9999.0, 200)) < 1e-3


def test_a_path_with_corners_needs_the_filter_and_is_followed_with_it():
    model = _model(_axes(280.0))
    cycles = np.arange(2400)[None] * T * 50.0
    triangle = 25.0 * (1.0 - 4.0 * np.abs((cycles + 0.25) % 1.0 - 0.5))
    law = HammersteinInverseLaw(model, 10.0, T, filter_hz=1500.0)
    drive = law.drive_for(triangle)
    error = np.abs(_position(model, drive) - triangle)[:, 800:-100]
    to_corner = np.abs((cycles[:, 800:-100] + 0.25) % 0.5 - 0.25)
    assert np.abs(drive).max() < 10.0
    assert error[to_corner < 0.15].max() < 0.05
    assert error.max() < 0.6  # the corners themselves are rounded
    bare = HammersteinInverseLaw(model, 10.0, T).drive_for(triangle)
    assert (np.abs(bare) == 10.0).sum() > 100


def test_a_path_goes_on_straight_beyond_its_ends():
    model = _model(_axes(280.0))
    ramp = np.linspace(-20.0, 20.0, 2000)[None]
    drive = HammersteinInverseLaw(model, 10.0, T, filter_hz=1000.0).drive_for(ramp)
    assert np.abs(_position(model, drive) - ramp)[:, 1000:].max() < 1e-6


def test_start_away_from_rest_neither_rings_nor_lasts():
    model = _model(_axes(280.0, 306.0))
    angle = 2.0 * np.pi * 50.0 * T * np.arange(1600)
    path = 30.0 * np.stack([np.cos(angle), np.sin(angle)])
    drive = HammersteinInverseLaw(model, 10.0, T).drive_for(path)
    error = np.abs(_position(model, drive) - path)
    assert error[:, 200:].max() < 0.1  # 10 ms; the plant alone would still ring with exp(-2.1) of 30 um
    assert error[:, 500:].max() < 1e-6


@pytest.mark.parametrize("time_s", [0.05, 0.2, 5.0])
@pytest.mark.parametrize("seed", range(3))
def test_creep_without_a_resonance_starts_from_rest(time_s, seed):
    """Its mode is too slow for the differences that find a start without ringing: they are rounding alone."""
    axis = Axis(resonance_hz=None, damping_ratio=None, creep=(CreepMode(gain=0.03, time_constant_s=time_s),))
    model = _model(AxesDynamics(axes=(axis,)))
    law = HammersteinInverseLaw(model, 10.0, T)
    wanted = 13.4 * np.random.default_rng(seed).uniform(0.5, 1.0) * _circle(5.0, 1.0, 20_000, axes=1)
    drive = law.drive_for(wanted)
    assert np.abs(drive[:, 0]).max() < 1e-6
    np.testing.assert_allclose(_position(model, drive), wanted, rtol=0, atol=1e-9)


def test_after_the_range_the_position_comes_back_at_once():
    model = _model(_axes(280.0, 306.0))
    path = _circle(50.0, 20.0, 2400)
    path[0, 700:1100] *= 1.0 + 4.0 * np.sin(np.pi * np.arange(400) / 400) ** 4  # beyond reach for a while
    law = HammersteinInverseLaw(model, 10.0, T)
    drive = law.drive_for(path)
    error = np.abs(_position(model, drive) - path)
    cut = np.flatnonzero((np.abs(drive[0]) == 10.0) & (np.arange(2400) > 400))
    assert len(cut) > 30
    assert np.abs(drive).max() == 10.0
    assert error[0, cut[0] : cut[-1]].max() > 1.0
    assert error[0, cut[-1] + 200 :].max() < 0.05
    assert error[0, cut[-1] + 500 :].max() < 1e-6
    assert error[1, 400 : cut[0]].max() < 1e-9


def test_a_path_shorter_than_the_preview_is_refused():
    law = HammersteinInverseLaw(_model(_axes(280.0)), 10.0, T, filter_hz=500.0)
    with pytest.raises(
        InputError, match=f"has 50 samples, but the law looks {law.needed_samples} samples ahead"
    ):
        law.drive_for(np.zeros((1, 50)))


@pytest.mark.parametrize("filter_hz", [None, 900.0])
@pytest.mark.parametrize(
    "dynamics",
    [
        _axes(280.0, 306.0),
        _axes(280.0, 306.0, delay=3),
        _axes(280.0, 306.0, creep=(CreepMode(gain=0.05, time_constant_s=30.0),)),
        _of((1.0 - S / 3e3) / (1.0 + S / 3e3) * RESONANT),
    ],
)
def test_a_stream_with_the_stated_preview_is_the_batch(dynamics, filter_hz):
    """To the last bit, from the same start, up to where the path must be continued beyond its end."""
    model = _model(dynamics)
    angle = 2.0 * np.pi * 50.0 * T * np.arange(1500) + 0.7
    path = 30.0 * np.stack([np.cos(angle), np.sin(angle)])[: model.hysteresis.n_outputs]
    law = HammersteinInverseLaw(model, 10.0, T, filter_hz=filter_hz)
    batch = law.drive_for(path)
    state, ahead, pieces = law.primed(path[:, : law.start_samples])[0], law.preview_samples, []
    for first, stop in ((0, 1), (1, 2), (2, 40), (40, 700), (700, path.shape[1] - ahead)):
        drive, state = law.respond(path[:, ahead + first : ahead + stop], state)
        state = law.restore(state.as_dict())
        pieces.append(drive)
    np.testing.assert_array_equal(np.hstack(pieces), batch[:, : path.shape[1] - ahead])


def test_the_start_hears_of_the_samples_that_it_states_and_of_no_other():
    law = HammersteinInverseLaw(_model(_axes(280.0, 306.0)), 10.0, T)
    angle = 2.0 * np.pi * 50.0 * T * np.arange(800)
    path = 30.0 * np.stack([np.cos(angle), np.sin(angle)])
    first = law.drive_for(path)[:, 0]
    for sample, moves in ((law.start_samples - 1, True), (law.start_samples, False), (300, False)):
        bent = path.copy()
        bent[:, sample] += 0.1
        assert bool(np.abs(law.drive_for(bent)[:, 0] - first).max() > 0.0) is moves
    assert f"must know its first {law.start_samples} samples" in law.statement()
    known = path[:, : law.start_samples]
    assert law.primed(path)[0].as_dict() == law.primed(known)[0].as_dict()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"filter_hz": 9000.0}, "filter_hz: must be between 0 and 7692"),
        ({"filter_hz": 0.0}, "filter_hz"),
        ({"preview_s": -1.0}, "preview_s: must be 0 or more"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        HammersteinInverseLaw(_model(_axes(280.0)), 10.0, T, **options)


def _discrete(a, b, c, d):
    return StateSpaceDynamics.of(control.ss(a, b, c, d, T))


@pytest.mark.parametrize(
    ("dynamics", "message"),
    [
        (_discrete([[1.01]], [[1.0]], [[1.0]], [[0.0]]), "not stable"),
        (_discrete([[0.5]], [[1.0]], [[0.0]], [[0.0]]), "Output 1 .* responds to no input"),
        # y = x[k] - x[k-1] behind a lag: a zero at z = 1, where no finite drive holds a position.
        (_discrete([[0.5, 0.0], [1.0, 0.0]], [[1.0], [0.0]], [[1.0, -1.0]], [[0.0]]), "zero at .z. = 1"),
        (
            _discrete(np.diag([0.5, 0.4]), [[1.0, 1.0], [1.0, 1.0]], np.eye(2), np.zeros((2, 2))),
            "the same combination of inputs",
        ),
    ],
)
def test_blocks_without_inverse_are_refused_with_the_reason(dynamics, message):
    with pytest.raises(SimulationError, match=message):
        linear_inverse(dynamics, T)


def test_more_inputs_than_outputs():
    pair = Pair([0.05, 0.4, 2.0], [3.0, 0.5, 1.0])
    model = HammersteinModel(
        "two for one", PrandtlIshlinskii(((pair, pair),)), _axes(280.0), 10.0, ("a", "b"), ("x",)
    )
    path = _circle(100.0, 40.0, 1600, 1)
    drive = HammersteinInverseLaw(model, 10.0, T).drive_for(path)
    np.testing.assert_allclose(drive[0], drive[1], atol=1e-9)
    assert np.abs(_position(model, drive) - path)[:, 400:].max() < 1e-9


@pytest.mark.parametrize("sample_time_s", [1e-3, 1e-6])
def test_the_lowest_bandwidth_of_a_filter_is_that_of_the_message(sample_time_s):
    """That which is named is the longest that is allowed."""
    with pytest.raises(InputError, match="needs a filter of") as caught:
        low_pass_taps(1e-5 / sample_time_s, sample_time_s)
    least = float(re.search(r"use (\S+) Hz or more", str(caught.value)).group(1))
    assert 98_000 < len(low_pass_taps(1.01 * least, sample_time_s)) <= 100_001
    with pytest.raises(InputError, match="needs a filter of"):
        low_pass_taps(0.99 * least, sample_time_s)
