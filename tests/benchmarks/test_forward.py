"""The hysteresis block, and the cascade with its dynamics, against everything else that does the same."""

import control
import numpy as np
import pytest
from cases import SAMPLE_TIME_S, noise, sines, walk, with_operators
from ratios import Work
from references import backlash_objects, best_textbook, hysteresis_and_dynamics, numpy_loop

from hammerstein.dynamics import discretise
from hammerstein.model import HammersteinModel

SINES = "Hysteresis, 2 x 2, 50 Hz sines"
NOISE = "Hysteresis, 2 x 2, white noise"
GRID = "Hysteresis, 2 x 2, against the best strict textbook loop"
OTHERS = "Hysteresis and dynamics, 2 x 2, 15 operators, 50 Hz sines"


def forward(model, u):
    return Work(lambda: model.respond(u), u.shape[1])


def against_textbook(bench, group, n, u, required):
    """The textbook loop works through a shorter piece of the signal; its time a sample is the same.

    What is required is asked of the quickest loop in strict arithmetic, which ours keeps to as well. The
    quickest one of all, which may reorder the weighted sums, is shown beside it.
    """
    model = with_operators(n)
    piece = np.ascontiguousarray(u[:, : max(2000, u.shape[1] * 15 // n)])
    what = f"{n} operators, {u.shape[1]:,} samples"
    for strict, limit in ((True, required), (False, None)):
        name, textbook = best_textbook(model, piece, strict)
        assert bench.compare(
            group, what, f"textbook loop, {name}", forward(model, u), textbook, ">=", limit
        ).acceptable


@pytest.mark.parametrize(("n", "required"), [(15, 3.0), (150, 10.0), (1500, 100.0)])
def test_sines_against_the_textbook_loop(bench, n, required):
    against_textbook(bench, SINES, n, sines(bench.samples), required)


@pytest.mark.parametrize(("n", "required"), [(15, 1.0 / 1.1), (60, 1.0), (1500, None)])
def test_noise_against_the_textbook_loop(bench, n, required):
    against_textbook(bench, NOISE, n, noise(bench.samples), required)


@pytest.mark.parametrize("n", [5, 15, 30, 60, 200])
@pytest.mark.parametrize("signal", [sines, walk, noise])
def test_grid_of_operators_and_signals(bench, signal, n):
    """Never slower than 1.1 times the textbook loop, in its own field too: few operators, many reversals."""
    model, u = with_operators(n), signal(bench.fewer(200_000))
    name, textbook = best_textbook(model, u, strict=True)
    ours, what = forward(model, u), f"{n} operators, {signal.__name__}"
    assert bench.compare(GRID, what, f"textbook loop, {name}", ours, textbook, ">=", 1.0 / 1.1).acceptable


def test_sines_against_a_memory_copy(bench, published):
    """Arrays larger than the caches of a processor in the short form too: its caches are not its memory."""
    u = sines(2_000_000)
    y = np.empty_like(u)
    ours, copy = forward(published.hysteresis, u), Work(lambda: np.copyto(y, u), u.shape[1])
    assert bench.compare(
        SINES, f"15 operators, {u.shape[1]:,} samples", "copy of its arrays", ours, copy, "<=", 12.0
    ).acceptable


def test_sines_against_a_loop_in_numpy(bench, published):
    model, u = published.hysteresis, sines(bench.fewer(20_000))
    np.testing.assert_allclose(numpy_loop(model, u), model.respond(u)[0], rtol=0, atol=1e-10)
    other = Work(lambda: numpy_loop(model, u), u.shape[1])
    ours = forward(model, sines(bench.samples))
    assert bench.compare(
        SINES, "15 operators", "NumPy loop over the samples", ours, other, ">=", 100.0, repeats=5
    ).acceptable


def test_sines_against_backlash_objects(bench, published):
    model, u = published.hysteresis, sines(bench.fewer(4000))
    np.testing.assert_allclose(backlash_objects(model, u), model.respond(u)[0], rtol=0, atol=1e-10)
    other = Work(lambda: backlash_objects(model, u), u.shape[1])
    ours = forward(model, sines(bench.samples))
    what = "control.friction_backlash_nonlinearity"
    assert bench.compare(SINES, "15 operators", what, ours, other, ">=", 500.0, repeats=5).acceptable


def test_cascade_against_a_block_diagram(bench):
    model = HammersteinModel.load("duo_bimorph")
    block, diagram = discretise(model.dynamics, SAMPLE_TIME_S), hysteresis_and_dynamics(model, SAMPLE_TIME_S)
    few, many = sines(bench.fewer(2000)), sines(bench.samples)
    time_s = np.arange(few.shape[1]) * SAMPLE_TIME_S

    def cascade(u):
        return block.respond(model.hysteresis.respond(u)[0])[0]

    def simulated():
        return control.input_output_response(diagram, time_s, few).outputs

    np.testing.assert_allclose(simulated(), cascade(few), rtol=0, atol=1e-9)
    ours, other = Work(lambda: cascade(many), many.shape[1]), Work(simulated, few.shape[1])
    assert bench.compare(
        OTHERS, "hysteresis, then dynamics", "control.interconnect", ours, other, ">=", 500.0, repeats=5
    ).acceptable


def test_linear_block_against_forced_response(bench):
    model = HammersteinModel.load("duo_bimorph")
    block, v = discretise(model.dynamics, SAMPLE_TIME_S), sines(bench.samples)
    system = control.ss(block.A, block.B, block.C, block.D, SAMPLE_TIME_S)
    few = v[:, : bench.fewer(100_000)]
    time_s = np.arange(few.shape[1]) * SAMPLE_TIME_S

    def forced():
        return control.forced_response(system, time_s, few).outputs

    np.testing.assert_allclose(forced(), block.respond(few)[0], rtol=0, atol=1e-9)
    ours, other = Work(lambda: block.respond(v), v.shape[1]), Work(forced, few.shape[1])
    assert bench.compare(
        OTHERS, "dynamics alone", "control.forced_response", ours, other, ">=", 20.0, repeats=5
    ).acceptable
