"""Kinds of hysteresis side by side, and the packaged stack that is made of them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import theory
from likeness import assert_alike
from shipped.stacks import asymmetric_stack

from hammerstein.compensators import ExactInverse
from hammerstein.errors import InputError
from hammerstein.hysteresis import Asymmetric, DeadZones, Pair, Parallel, PrandtlIshlinskii, RateDependent
from hammerstein.model import HammersteinModel

T = 50e-6


@pytest.fixture(scope="module")
def stack() -> HammersteinModel:
    return HammersteinModel.load("asymmetric_stack").on_grid(T)


def drive(samples: int = 1500) -> np.ndarray:
    """Both inputs, fast and slow, with minor loops."""
    t = T * np.arange(samples)
    return np.stack(
        [6.0 * np.sin(400.0 * t) + 3.0 * np.sin(1900.0 * t), 7.0 * np.sin(700.0 * t + 1.0) * t / t[-1]]
    )


def test_the_outputs_of_the_parts_add_as_theory_says(stack: HammersteinModel) -> None:
    bent, growing = stack.hysteresis.parts
    assert isinstance(bent, Asymmetric)
    assert isinstance(growing, RateDependent)
    u = drive()
    static = theory.asymmetric(
        u,
        [[pair.thresholds_v for pair in row] for row in bent.plays.pairs],
        [[pair.weights_um_per_v for pair in row] for row in bent.plays.pairs],
        [[zones.breakpoints_v for zones in row] for row in bent.zones],
        [[zones.weights_um_per_v for zones in row] for row in bent.zones],
        [0.0, 0.0],
    )
    plays = growing.inputs
    rate = theory.rate_dependent(
        u,
        T,
        [one.thresholds_v for one in plays],
        [one.growth_s for one in plays],
        [one.bandwidth_hz for one in plays],
        [one.lambda_s_per_v for one in plays],
        growing.weights_um_per_v,
    )
    np.testing.assert_allclose(stack.hysteresis.respond(u)[0], static + rate, atol=1e-9)


def test_a_step_and_a_cut_give_the_same_bits(stack: HammersteinModel) -> None:
    block, u = stack.hysteresis, drive(300)
    whole, end = block.respond(u)
    first, state = block.respond(u[:, :120])
    second, last = block.respond(u[:, 120:], block.restore(json.loads(json.dumps(state.as_dict()))))
    np.testing.assert_array_equal(np.hstack([first, second]), whole)
    assert last.as_dict() == end.as_dict()
    steps, memory = [], block.rest()
    for sample in u.T:
        y, memory = block.step(sample, memory)
        steps.append(y)
    np.testing.assert_array_equal(np.transpose(steps), whole)


def random_plays(seed: int) -> PrandtlIshlinskii:
    generator = np.random.default_rng(seed)
    r = [np.sort(np.append(0.0, generator.uniform(0.0, 6.0, 4))) for _ in range(4)]
    pairs = [Pair(own, generator.normal(size=5)) for own in r]
    return PrandtlIshlinskii([pairs[:2], pairs[2:]])


def bent(plays: PrandtlIshlinskii) -> Asymmetric:
    zones = [[DeadZones([-2.0, 3.0], [0.5, -0.3])] * 2, [DeadZones([0.0], [0.2])] * 2]
    return Asymmetric(plays, zones)


def way(*turns: float, samples: int = 60) -> np.ndarray:
    ends = np.arange(len(turns)) * samples
    return np.stack([np.interp(np.arange(ends[-1] + 1), ends, turns)] * 2)


def test_classical_blocks_side_by_side_are_a_classical_block() -> None:
    one, two, u = random_plays(1), random_plays(2), drive(400)

    def joined(name: str) -> list[list[np.ndarray]]:
        return [
            [np.append(getattr(a, name), getattr(b, name)) for a, b in zip(*both, strict=True)]
            for both in zip(one.pairs, two.pairs, strict=True)
        ]

    expected = theory.prandtl_ishlinskii(u, joined("thresholds_v"), joined("weights_um_per_v"))
    np.testing.assert_allclose(Parallel((one, two)).respond(u)[0], expected, atol=1e-10)


def test_wiping_out_holds_as_far_as_it_holds_for_every_part(stack: HammersteinModel) -> None:
    """Plays and dead-zones forget what a larger swing covers; a part that knows the rate does not."""
    last = way(-9.0, 9.0, 2.0)

    def end(block: Parallel, past: np.ndarray) -> np.ndarray:
        return block.respond(np.hstack([past, last]))[0][:, -1]

    slow, other = way(0.0, 8.0, -3.0, -9.0, samples=300), way(0.0, -5.0, 6.0, -9.0, samples=300)
    still = Parallel((random_plays(1), bent(random_plays(2))))
    np.testing.assert_allclose(end(still, slow), end(still, other), atol=1e-10)
    fast = way(0.0, 9.0, -9.0, samples=40)

    def after(block: Parallel, past: np.ndarray) -> np.ndarray:
        return block.respond(np.hstack([past, way(-9.0, 0.0, samples=60)]))[0][:, -1]

    gentle = way(0.0, 9.0, -9.0, samples=2000)
    np.testing.assert_allclose(after(still, fast), after(still, gentle), atol=1e-10)
    assert np.abs(after(stack.hysteresis, fast) - after(stack.hysteresis, gentle)).max() > 1e-3


def test_congruency_holds_between_the_same_voltages_alone(stack: HammersteinModel) -> None:
    """Whatever went before; elsewhere dead-zones bend the loop, and at another rate it is another one."""

    def loop(block: Parallel, past: tuple[float, ...], middle: float, samples: int = 60) -> np.ndarray:
        inner = [middle - 1.0, middle + 1.5] * 4
        u = np.hstack([way(0.0, *past, inner[0], samples=300), way(*inner, samples=samples)])
        v = block.respond(u)[0][:, -2 * samples - 1 :: samples]
        return v - v[:, :1]

    still = Parallel((random_plays(1), bent(random_plays(2))))
    first, second = (loop(still, past, 0.0) for past in ((-9.0, 9.0), (5.0, -7.0)))
    np.testing.assert_allclose(first, second, atol=1e-10)
    assert np.abs(first - loop(still, (-9.0, 9.0), 4.0)).max() > 0.1
    slow, fast = (loop(stack.hysteresis, (-9.0, 9.0), 0.0, samples) for samples in (600, 10))
    assert np.abs(slow - fast).max() > 1e-2


def test_weights_go_out_and_in(stack: HammersteinModel) -> None:
    block = stack.hysteresis
    doubled = block.with_weights([2.0 * w for w in block.weights])
    np.testing.assert_allclose(doubled.respond(drive())[0], 2.0 * block.respond(drive())[0], rtol=1e-12)
    assert [len(w) for w in block.weights] == [sum(row) for row in block.operators]
    assert block.n_beside_weights == sum(part.n_beside_weights for part in block.parts) > 0


def test_the_packaged_stack_is_that_of_its_recipe(stack: HammersteinModel) -> None:
    assert_alike(asymmetric_stack(stack.instruments), stack)


def test_the_stack_is_asymmetric_widens_with_the_rate_and_creeps(stack: HammersteinModel) -> None:
    def width(hz: float) -> float:
        n = round(1.0 / (hz * T))
        u = np.zeros((2, 3 * n))
        u[0] = 10.0 * np.sin(2.0 * np.pi * np.arange(3 * n) / n)
        loop = stack.hysteresis.respond(u)[0][0, -n:]
        return float(abs(loop[0] - loop[n // 2]) / np.ptp(loop))

    assert width(1.0) == pytest.approx(0.12, abs=0.01)
    assert width(200.0) > 1.35 * width(1.0)
    low, high = stack.hysteresis.extremes(np.full(2, -10.0), np.full(2, 10.0))
    assert high[0] > 1.1 * -low[0]  # x grows upwards, y flattens
    assert high[1] < 0.95 * -low[1]
    assert all(len(axis.creep) == 2 for axis in stack.dynamics.axes)


def test_it_cannot_be_inverted_and_says_so(stack: HammersteinModel) -> None:
    with pytest.raises(InputError, match="'parallel' has no exact inverse"):
        ExactInverse().design(stack, 10.0, T)


def test_parts_of_different_shapes_are_refused() -> None:
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    two = PrandtlIshlinskii([[Pair([0.0], [1.0]), Pair([0.0], [1.0])]])
    for parts in ((one,), (one, two)):
        with pytest.raises(InputError, match="two parts or more"):
            Parallel(parts)


def test_a_parallel_part_is_refused() -> None:
    one = PrandtlIshlinskii([[Pair([0.0], [1.0])]])
    with pytest.raises(InputError, match="give all parts in one"):
        Parallel((Parallel((one, one)), one))
