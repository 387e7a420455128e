from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from hammerstein.arrays import transfer
from hammerstein.dynamics import LinearBlock
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.linear import state_space
from hammerstein.identification.linear.frequency_response import FrequencyResponse, frequency_response
from hammerstein.identification.linear.state_space import (
    Matrices,
    WeightedLines,
    _Place,
    fit_state_space,
    refine,
    split,
    stable,
    subspace,
    weigh,
)

Array = NDArray[np.float64]
DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "cubespec_fsm"
T = 5e-5


def output_error_percent(block: LinearBlock, response: FrequencyResponse) -> Array:
    """Error rms over output rms of a model in the experiments behind a response, noise included (p,) [%].

    100 sqrt( sum of (G - G_measured) S_uu (G - G_measured)^H + residue  /  sum of output power )
    """
    z = np.exp(2j * np.pi * response.frequency_hz * block.sample_time_s)
    error = transfer(block.A, block.B, block.C, block.D, z).transpose(1, 2, 0) - response.response
    power = np.einsum("ijf,jkf,ikf->if", error, response.input_power, error.conj()).real
    left = np.sum(power + response.residual_power, axis=1)
    return np.asarray(100.0 * np.sqrt(left / response.output_power.sum(axis=1)))


def random_system(rng: np.random.Generator, n: int, m: int, p: int) -> control.StateSpace:
    """Stable discrete system with direct feedthrough, resonant and real poles, on mixed coordinates."""
    A = np.zeros((n, n))
    for i in range(0, n - 1, 2):
        r, angle = rng.uniform(0.5, 0.95), rng.uniform(0.1, 3.0)
        A[i : i + 2, i : i + 2] = r * np.array(
            [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
        )
    if n % 2:
        A[-1, -1] = rng.uniform(-0.9, 0.95)
    mix = np.linalg.qr(rng.standard_normal((n, n)))[0]
    B, C, D = (rng.standard_normal(shape) for shape in ((n, m), (p, n), (p, m)))
    return control.ss(mix.T @ A @ mix, mix.T @ B, C @ mix, D, T)


def response_of(system: control.StateSpace, frequency_hz: Array) -> NDArray[np.complex128]:
    """C (z - A)^-1 B + D, written out."""
    n = system.nstates
    gains = [
        system.C @ np.linalg.inv(np.exp(2j * np.pi * f * T) * np.eye(n) - system.A) @ system.B + system.D
        for f in frequency_hz
    ]
    return np.stack(gains, axis=2)


def measured(
    system: control.StateSpace, rng: np.random.Generator, period: int, *, settle: int, noise: float = 0.0
) -> FrequencyResponse:
    """Response of as many periodic experiments as inputs, simulated in time."""
    u = [np.tile(rng.standard_normal((system.ninputs, period)), settle + 2) for _ in range(system.ninputs)]
    y = []
    for x in u:
        clean = np.atleast_2d(control.forced_response(system, inputs=x, squeeze=False).outputs)
        y.append(clean + noise * rng.standard_normal(clean.shape))
    first = settle * period
    return frequency_response([x[:, first:] for x in u], [x[:, first:] for x in y], T, period_samples=period)


def exact(system: control.StateSpace, frequency_hz: Array) -> FrequencyResponse:
    """Response of a system, excited alike by all its inputs, without noise."""
    response, F, m = response_of(system, frequency_hz), len(frequency_hz), system.ninputs
    return FrequencyResponse(
        frequency_hz=frequency_hz,
        response=response,
        coherence=np.ones((system.noutputs, F)),
        input_power=np.repeat(np.eye(m, dtype=complex)[:, :, None], F, axis=2),
        residual_power=np.zeros((system.noutputs, F)),
        sample_time_s=T,
    )


def everywhere() -> Array:
    return np.linspace(1.0, 0.5 / T, 150)


def worst(block: LinearBlock, system: control.StateSpace, frequency_hz: Array) -> float:
    """Largest error of the frequency response, relative to the largest response."""
    truth = response_of(system, frequency_hz)
    model = response_of(control.ss(block.A, block.B, block.C, block.D, T), frequency_hz)
    return float(np.abs(model - truth).max() / np.abs(truth).max())


@pytest.mark.parametrize(
    ("n", "m", "p"), [(1, 1, 1), (2, 1, 1), (4, 2, 2), (5, 1, 3), (5, 3, 1), (6, 2, 3), (8, 3, 2), (12, 3, 3)]
)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_random_system_is_recovered_from_steady_periods(n: int, m: int, p: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    system = random_system(rng, n, m, p)
    block = fit_state_space(measured(system, rng, 256, settle=3), n)
    assert block.A.shape == (n, n)
    assert worst(block, system, everywhere()) < 1e-8
    poles = np.sort_complex(np.linalg.eigvals(block.A))
    assert np.allclose(poles, np.sort_complex(np.linalg.eigvals(system.A)), atol=1e-6)
    u = rng.standard_normal((m, 400))
    truth = control.forced_response(system, inputs=u, squeeze=False).outputs
    assert np.abs(block.respond(u)[0] - truth).max() < 1e-8 * np.abs(truth).max()


def test_many_lines_are_handled_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    system = random_system(rng, 4, 2, 2)
    lines = weigh(exact(system, everywhere()))
    model = lines_model(system, rng)
    whole = sums(lines, model)
    start = lines.cost(subspace(lines, 3, 4))
    monkeypatch.setattr(state_space, "CHUNK", 40)
    for one, other in zip(whole, sums(lines, model), strict=True):
        assert np.allclose(one, other, rtol=1e-12, atol=1e-12 * np.abs(one).max())
    assert lines.cost(subspace(lines, 3, 4)) == pytest.approx(start, rel=1e-9)


def sums(lines: WeightedLines, model: Matrices) -> list[Array]:
    blocks = split(model)
    return [np.array([lines.cost(model), blocks.cost(lines)]), *_Place(blocks, lines, 0.0).normal_equations]


def test_a_long_record() -> None:
    system = random_system(np.random.default_rng(3), 4, 2, 2)
    assert worst(fit_state_space(exact(system, np.arange(1.0, 9999.0, 2.0)), 4), system, everywhere()) < 1e-8


def test_modes_far_below_the_sample_rate() -> None:
    """Six resonances from 50 to 400 Hz at 20 kHz: the powers of z are then nearly alike at all lines."""
    modes = [signal.cont2discrete(mode(f, 0.02), T)[:4] for f in (50.0, 90.0, 150.0, 220.0, 300.0, 400.0)]
    system = control.parallel(*(control.ss(a, b, c, d, T) for a, b, c, d in modes)) + 0.1
    block = fit_state_space(exact(system, np.arange(5.0, 600.0, 2.5)), 12)
    assert worst(block, system, np.arange(5.0, 600.0, 1.0)) < 1e-8


def mode(frequency_hz: float, damping_ratio: float) -> tuple[Array, Array, Array, Array]:
    w = 2 * np.pi * frequency_hz
    a = np.array([[0.0, w], [-w, -2 * damping_ratio * w]])
    return a, np.array([[0.0], [w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))


def test_a_delay_of_several_samples() -> None:
    """Four poles at 0 share one eigenvector, so that A cannot be taken apart."""
    delay = control.ss(np.eye(4, k=-1), np.eye(4, 1), np.eye(4)[3:], [[0.0]], T)
    system = control.series(random_system(np.random.default_rng(4), 2, 1, 1), delay)
    assert (
        worst(fit_state_space(exact(system, np.arange(50.0, 9999.0, 50.0)), 6), system, everywhere()) < 1e-8
    )


def test_two_equal_axes() -> None:
    one = control.ss(*mode_on_grid(300.0), T)
    system = control.append(one, one)
    block = fit_state_space(exact(system, np.arange(50.0, 9999.0, 50.0)), 4)
    assert worst(block, system, everywhere()) < 1e-8


def mode_on_grid(frequency_hz: float) -> tuple[Array, Array, Array, Array]:
    a, b, c, d, _ = signal.cont2discrete(mode(frequency_hz, 0.1), T)
    return a, b, c, d


def test_noise_costs_what_the_number_of_parameters_says() -> None:
    """An efficient fit of d parameters to lines with noise of variance s^2 keeps s^2 d / 2 of it.

    With ``power`` the errors are those of the outputs, so that the sum over the lines of |dG R|^2 counts.
    """
    rng = np.random.default_rng(5)
    n, m, p, s = 4, 2, 2, 1e-2
    system = random_system(rng, n, m, p)
    # outputs of one size, so that white noise is weighed right
    truth = exact(system, np.arange(50.0, 9999.0, 50.0))
    size = np.sqrt(truth.output_power.mean(axis=1))
    system = control.ss(system.A, system.B, system.C / size[:, None], system.D / size[:, None], T)
    truth = exact(system, truth.frequency_hz)
    kept = []
    for _ in range(24):
        noise = rng.standard_normal((2, *truth.response.shape)) * s / np.sqrt(2.0)
        noisy = replace(truth, response=truth.response + noise[0] + 1j * noise[1])
        block = fit_state_space(noisy, n, tolerance=1e-6)
        kept.append(
            np.sum(np.abs(block.response(truth.frequency_hz).transpose(1, 2, 0) - truth.response) ** 2)
        )
    parameters = n * (m + p) + m * p
    # chi-square of 20 degrees of freedom, mean of 24: 6.5 % standard deviation
    assert np.mean(kept) == pytest.approx(s**2 * parameters / 2.0, rel=0.25)


def test_too_small_an_order_is_refined_to_a_minimum() -> None:
    """The slope of the sum of squares over B and D vanishes: the fit is a least-squares one."""
    rng = np.random.default_rng(21)
    system = random_system(rng, 10, 2, 2)
    g = exact(system, everywhere())
    texts: list[str] = []
    block = fit_state_space(g, 6, tolerance=1e-9, max_iterations=200, progress=texts.append)
    reached = output_error_percent(block, g)
    lines = weigh(g)
    starts = [lines.percent(lines.cost(subspace(lines, 6, rows))) for rows in (7, 14)]
    assert np.sqrt(np.mean(reached**2)) < 0.95 * min(starts)
    for name, row in (("B", 0), ("B", 5), ("D", 1), ("C", 1), ("A", 2)):
        for sign in (1.0, -1.0):
            matrix = getattr(block, name).copy()
            matrix[row, 0] += sign * 1e-4 * np.abs(matrix).max()
            beside = replace(block, **{name: matrix})
            assert np.mean(output_error_percent(beside, g) ** 2) >= np.mean(reached**2) * (1.0 - 1e-9)
    assert texts[0].startswith("start with 7 block rows: ")
    assert (
        texts[-1]
        == f"{texts[-1].split(':')[0]}: {np.sqrt(np.mean(reached**2)):.4g} % of the output not explained"
    )


@pytest.mark.parametrize("whole", [False, True])
def test_the_jacobian_is_that_of_finite_differences(whole: bool) -> None:
    rng = np.random.default_rng(8)
    system = random_system(rng, 5, 2, 3)
    lines = weigh(exact(system, everywhere()))
    start = Matrices(
        *(x + 0.01 * rng.standard_normal(x.shape) for x in (system.A, system.B, system.C, system.D))
    )
    blocks = split(start)
    assert blocks.cost(lines) == pytest.approx(lines.cost(start))
    assert [part.stop - part.start for part in blocks.parts] == [2, 2, 1]
    if whole:
        blocks = replace(blocks, model=start, parts=(slice(0, 5),))
    gradient = _Place(blocks, lines, 0.0).normal_equations[1]
    for i, step in enumerate(1e-6 * np.eye(len(gradient))):
        slope = (blocks.moved(step).cost(lines) - blocks.moved(-step).cost(lines)) / 2e-6
        assert 2.0 * gradient[i] == pytest.approx(slope, rel=1e-4, abs=1e-6 * np.abs(gradient).max())


def test_refinement_from_far_away_ends_at_the_truth() -> None:
    rng = np.random.default_rng(9)
    system = random_system(rng, 4, 2, 2)
    lines = weigh(exact(system, everywhere()))
    start = lines_model(system, rng)
    model = refine(lines, start, 100, 1e-12, lambda number, cost: None)
    assert lines.cost(start) > 1e-2 * lines.total
    assert lines.cost(model) < 1e-18 * lines.total


def lines_model(system: control.StateSpace, rng: np.random.Generator) -> Matrices:
    """The system with its matrices disturbed by a tenth."""
    return Matrices(
        *(x * (1.0 + 0.1 * rng.standard_normal(x.shape)) for x in (system.A, system.B, system.C, system.D))
    )


def test_an_unstable_response_still_gives_a_stable_model() -> None:
    ahead = replace(
        (g := exact(random_system(np.random.default_rng(10), 3, 1, 1), everywhere())),
        response=g.response
        * np.exp(2j * np.pi * g.frequency_hz * 3 * T),  # the output leads by three samples
    )
    block = fit_state_space(ahead, 4)
    assert np.abs(np.linalg.eigvals(block.A)).max() < 1.0


def test_no_step_leaves_the_unit_circle() -> None:
    outside = control.ss([[1.02]], [[1.0]], [[1.0]], [[0.0]], T)
    lines = weigh(exact(outside, everywhere()))
    start = Matrices(np.array([[0.98]]), np.array([[1.0]]), np.array([[1.0]]), np.array([[0.0]]))
    assert abs(refine(lines, start, 50, 1e-9, lambda number, cost: None).A[0, 0]) < 1.0


def test_neighbouring_real_poles_share_a_block() -> None:
    A = np.diag([0.9, -0.5, 0.8, -0.4, 0.0])
    blocks = split(Matrices(A, np.ones((5, 1)), np.ones((1, 5)), np.zeros((1, 1))))
    poles = [np.sort(np.linalg.eigvals(blocks.model.A[part, part])).tolist() for part in blocks.parts]
    assert poles == [[-0.5, -0.4], [0.0, 0.8], [0.9]]


def test_poles_outside_the_circle_are_mirrored() -> None:
    angle = 0.7
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    A = np.zeros((4, 4))
    A[:2, :2], A[2, 2], A[3, 3] = 1.25 * turn, -2.0, 0.3
    A[0, 3] = 1.0
    poles = np.sort_complex(np.linalg.eigvals(stable(A)))
    wanted = np.sort_complex(np.array([0.8 * np.exp(1j * angle), 0.8 * np.exp(-1j * angle), -0.5, 0.3]))
    assert np.allclose(poles, wanted)
    assert np.isrealobj(stable(A))


def test_too_few_lines_for_the_order() -> None:
    system = random_system(np.random.default_rng(11), 20, 2, 1)
    with pytest.raises(
        IdentificationError, match="order 20 with 2 inputs and 1 outputs needs at least 16 lines"
    ):
        fit_state_space(exact(system, np.linspace(100.0, 9900.0, 15)), 20)
    assert fit_state_space(exact(system, np.linspace(100.0, 9900.0, 16)), 20).A.shape == (20, 20)


def test_an_output_at_rest_is_named() -> None:
    g = exact(control.ss([[0.5]], [[1.0]], [[1.0], [0.0]], [[1.0], [0.0]], T), everywhere())
    with pytest.raises(IdentificationError, match="output 2 does not respond"):
        fit_state_space(g, 1)


def test_an_order_below_one_is_refused() -> None:
    g = exact(random_system(np.random.default_rng(13), 2, 1, 1), everywhere())
    with pytest.raises(InputError, match="at least 1 state"):
        fit_state_space(g, 0)


@pytest.mark.parametrize(
    ("level", "limit"),
    [(100, 5.8), *(pytest.param(*more, marks=pytest.mark.long) for more in ((200, 5.1), (300, 4.7)))],
)
@pytest.mark.full
def test_measured_mirror(level: int, limit: float) -> None:
    """Order 28, fitted on the training realisations, simulated in time on the test realisations."""
    if not DATA.is_dir():
        pytest.skip("the measured records of the CubeSpec mirror are not on this machine")
    u, y = mirror(level, "train")
    g = frequency_response(u, y, 1 / 6400.0, period_samples=8192)
    block = fit_state_space(g, 28, max_iterations=3)
    assert np.abs(np.linalg.eigvals(block.A)).max() < 1.0
    error, size = np.zeros(3), np.zeros(3)
    for x, truth in zip(*mirror(level, "test"), strict=True):
        steady = signal.dlsim((block.A, block.B, block.C, block.D, 1 / 6400.0), x.T)[1].T[:, 8192:]
        error += np.sum((truth - np.tile(steady, 2)) ** 2, axis=1)
        size += np.sum(truth**2, axis=1)
    assert 100.0 * np.mean(np.sqrt(error / size)) < limit


def mirror(level: int, part: str) -> tuple[list[Array], list[Array]]:
    """Inputs [V] and outputs [um], one array (axis, two periods) a realisation."""

    def load(name: str, scale: float) -> list[Array]:
        values = scale * np.load(DATA / f"{name}_{level}mV_{part}.npy")
        return [np.concatenate([one[..., 0], one[..., 1]]).T for one in np.moveaxis(values, 2, 0)]

    return load("u", 1.0), load("y", 1e6)


class Downhill:
    """Blocks that lower the cost wherever they go, and note how far they were moved."""

    class model:  # noqa: N801 - as the blocks name it
        A = np.zeros((1, 1))

    def moved(self, step: Array) -> Downhill:
        self.step = step
        return self

    def cost(self, lines: object) -> float:
        return 0.0


def test_a_parameter_that_nothing_depends_on_does_not_stop_the_others() -> None:
    blocks = Downhill()
    here = _Place(blocks, None, 1.0)  # type: ignore[arg-type]
    vars(here)["normal_equations"] = np.diag([4.0, 0.0]), np.array([2.0, 0.0])
    there = here.step(1e-3)
    assert there.blocks is blocks
    assert there.cost == 0.0
    np.testing.assert_allclose(blocks.step, [-0.5, 0.0], rtol=2e-3)
