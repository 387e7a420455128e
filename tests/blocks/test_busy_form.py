"""An input that turns all the time takes another form: with its past alone, and to the same numbers."""

import json

import numpy as np
import pytest
import theory

from hammerstein.blocks.instruments import Instruments, Sensor
from hammerstein.compensators.base import DecoupledInverseLaw
from hammerstein.compensators.feedback.loop import Gains
from hammerstein.compensators.feedback.pid import FeedbackController, closed_loop
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.hysteresis.play_kernels import BUSY, LOOK, TURN, WINDOW
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import WIRES, Plant

SAMPLES = 6 * WINDOW


def noise(rng, samples=SAMPLES):
    return rng.uniform(-11.0, 11.0, samples)


def walk(rng, samples=SAMPLES):
    return np.clip(np.cumsum(rng.normal(0.0, 0.5, samples)), -11.0, 11.0)


def quiet(rng, samples=SAMPLES):
    return 10.0 * np.sin(np.arange(samples) / 100.0 + rng.uniform(0.0, 6.0))


def bursts(rng, samples=SAMPLES):
    """Slow sines with noise between; both last longer than a window, and no whole number of them."""
    loud = np.arange(samples) % (3 * WINDOW + 70) > 2 * WINDOW - 100
    return np.where(loud, noise(rng, samples), quiet(rng, samples))


def plateaus(rng, samples=SAMPLES):
    """Every voltage stays for a sample or two, where it turns and where it does not."""
    return np.repeat(bursts(rng, samples), rng.integers(1, 3, samples))[:samples]


def meeting(rng, samples=SAMPLES):
    """Voltages that thresholds on one coarse grid meet exactly, all the time."""
    return rng.integers(-8, 9, samples) * 0.5


def trembling(rng, samples=SAMPLES):
    """A slow sine with a tremor that the dead zone of the smallest threshold swallows in part."""
    return quiet(rng, samples) + rng.uniform(-0.1, 0.1, samples)


SIGNALS = [noise, walk, bursts, plateaus, meeting, trembling]


def model_of(n, smallest=0.0, shape=(1, 1)):
    """Pairs (output, input) of n operators on a grid of halves, the last pair absent if there are several."""
    rng = np.random.default_rng(n)
    r = smallest + 0.5 * np.arange(n)
    rows = [[Pair(r, rng.uniform(-0.2, 1.0, n)) for _ in range(shape[1])] for _ in range(shape[0])]
    if shape != (1, 1):
        rows[-1][-1] = Pair.absent()
    return PrandtlIshlinskii(rows)


def of_shape(shape, signal, seed=3):
    rng = np.random.default_rng(seed)
    return np.stack([(signal if k % 2 == 0 else bursts)(rng) for k in range(shape[1])])


def assert_same_memory(model, a, b):
    """The same plays and form; what lies above the top of a stack is no part of it."""
    for own, other in zip(model.plays_of(a), model.plays_of(b), strict=True):
        np.testing.assert_array_equal(own, other)
    np.testing.assert_array_equal(a.count, b.count)
    np.testing.assert_array_equal(a.window, b.window)


def in_pieces(model, u, cuts):
    """Outputs piece after piece, each from the state that the last one left, as JSON keeps it."""
    state, pieces, forms = model.rest(), [], []
    for piece in np.split(u, cuts, axis=1):
        v, state = model.respond(piece, state)
        state = model.restore(json.loads(json.dumps(state.as_dict())))
        pieces.append(v)
        forms.append(state.window[:, BUSY])
    return np.concatenate(pieces, axis=1), np.array(forms), state


@pytest.mark.parametrize("n", [1, 4, 5, 6, 15, 30])
def test_an_input_goes_over_while_it_turns_and_comes_back(n):
    rng, model = np.random.default_rng(1), model_of(n)
    u = np.concatenate([quiet(rng), noise(rng), quiet(rng)])[None]
    _, forms, _ = in_pieces(model, u, [SAMPLES, 2 * SAMPLES])
    assert forms[:, 0].tolist() == [0.0, 1.0, 0.0]


def test_an_input_of_many_operators_never_goes_over():
    """Two samples of three turn: beyond 2/3 TURN operators the turning-point form is the quicker one."""
    for n in (TURN - 5, TURN, 200):
        assert model_of(n).respond(noise(np.random.default_rng(1))[None])[1].window[0, BUSY] == 0.0


def test_the_form_of_an_input_is_its_own():
    """Another input beside it changes nothing, and no weight does."""
    model, u = model_of(7, 0.07, (2, 3)), of_shape((2, 3), noise)
    alone = PrandtlIshlinskii([[Pair(model.bank.r[0], np.ones(7))]])
    window = model.respond(u)[1].window[0]
    np.testing.assert_array_equal(alone.respond(u[:1])[1].window[0], window)


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize(("n", "smallest"), [(1, 0.0), (1, 0.25), (4, 0.0), (6, 0.25), (15, 0.07), (40, 0.0)])
def test_outputs_and_plays_are_those_of_equation_1(n, smallest, signal):
    model, u = model_of(n, smallest), signal(np.random.default_rng(2))
    p = np.array([theory.play(u, r) for r in model.bank.r[0]])
    v, state = model.respond(u[None])
    scale = np.abs(model.bank.w).sum() * np.abs(u).max()
    np.testing.assert_allclose(v[0], model.bank.w[0, :, 0] @ p, rtol=0, atol=1e-12 * scale)
    np.testing.assert_allclose(model.plays_of(state)[0], p[:, -1], rtol=0, atol=1e-12 * np.abs(u).max())


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("shape", [(1, 1), (3, 2), (2, 3)])
@pytest.mark.parametrize(("n", "smallest"), [(1, 0.0), (5, 0.0), (7, 0.07), (16, 0.25)])
def test_no_cut_changes_a_bit(n, smallest, shape, signal):
    """Samples one by one in three places, then pieces of any length; states go through JSON between them."""
    model, u = model_of(n, smallest, shape), of_shape(shape, signal)
    v, state = model.respond(u)
    rng = np.random.default_rng(n)
    windows = (LOOK, LOOK + WINDOW, 3 * WINDOW)
    singles = [t for window in windows for t in range(window - 20, window + 40)]
    cuts = np.unique([*singles, *rng.integers(0, SAMPLES, 40)])
    cut, forms, last = in_pieces(model, u, cuts)
    np.testing.assert_array_equal(cut, v)
    assert_same_memory(model, last, state)
    assert forms.any() or signal in (walk, trembling)  # the dead zone swallows most turns of these


def test_steps_are_a_run_to_the_last_bit():
    model, u = model_of(9, 0.07, (3, 2)), of_shape((3, 2), bursts)
    v, state = model.respond(u)
    now = model.rest()
    for t in range(SAMPLES):
        out, now = model.step(u[:, t], now)
        np.testing.assert_array_equal(out, v[:, t])
    assert_same_memory(model, now, state)


def test_what_a_swing_wiped_out_is_gone_to_the_last_bit():
    """After the way back into the turning-point form nothing is left of what was busy before."""
    rng, model = np.random.default_rng(4), model_of(15, 0.07)
    calm = 20.0 * np.cos(np.arange(3 * WINDOW) / 100.0)
    after_noise = model.respond(np.concatenate([noise(rng), calm])[None])[0][:, -WINDOW:]
    np.testing.assert_array_equal(after_noise, model.respond(calm[None])[0][:, -WINDOW:])


def test_a_loop_with_feedback_is_the_plant_to_the_last_bit():
    """A controller that hands on the sensor's noise makes its voltage turn in two samples of three."""
    model = HammersteinModel.load("duo_bimorph")
    plant = Plant(model, Instruments(sensor=Sensor(noise_um=5.0)))
    gains = Gains(*(np.full(2, gain) for gain in (0.3, 20.0, 0.0)))
    law = FeedbackController(model, 10.0, plant.sample_time_s, gains=gains)
    path = np.zeros((2, SAMPLES))
    ours, theirs = closed_loop(law, plant, path, [3]), plant.closed_loop(law, path, [3])
    for name in WIRES:
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
    counted = ours.drive_v - np.array(model.recorded.working_point_v)[:, None]
    assert model.hysteresis.respond(counted)[1].window[:, BUSY].all()


def test_steps_of_a_law_that_holds_plays_are_its_run():
    model = HammersteinModel.load("duo_bimorph")
    law = DecoupledInverseLaw(model, 10.0)
    reference = np.stack([bursts(np.random.default_rng(k), 4 * WINDOW) for k in (1, 2)])
    drive, end = law.respond(reference)
    state = law.rest()
    for t in range(reference.shape[1]):
        u, state = law.step(reference[:, t], state)
        np.testing.assert_array_equal(u, drive[:, t])
    assert_same_memory(law.inverse, state.plays, end.plays)


def test_a_memory_of_another_version_is_refused_by_name():
    block = PrandtlIshlinskii([[Pair([0.5], [2.0])]])
    kept = block.rest().as_dict()
    del kept["window"]
    with pytest.raises(InputError, match=r"has no window: .* start at rest"):
        block.restore(kept)
