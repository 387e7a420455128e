"""How the time of the hysteresis block grows with samples, operators and axes (ratio: times the smaller)."""

import pytest
from cases import noise, sines, with_operators
from ratios import Work

SIGNALS = {"50 Hz sines": sines, "white noise": noise}
GROUP = "Growth of the time a sample (ratio: times the time a sample of what it is compared with)"


def work(model, u):
    return Work(lambda: model.respond(u), u.shape[1])


@pytest.mark.parametrize(("signal", "required"), [("50 Hz sines", 2.0), ("white noise", 3.0)])
def test_growth_with_operators(bench, signal, required):
    u = SIGNALS[signal](bench.samples)
    small = work(with_operators(15), u)
    for n, limit in ((150, None), (1500, required), (10_000, None)):
        large = work(with_operators(n), u)
        assert bench.compare(
            GROUP, f"{n} operators, {signal}", "15 operators", large, small, "<=", limit
        ).acceptable


@pytest.mark.parametrize("axes", [1, 3, 4])
def test_growth_with_axes(bench, axes):
    if bench.short and axes != 3:
        pytest.skip("the full form compiles loops for other numbers of axes, too")
    model, u = with_operators(15, axes), sines(bench.samples, axes)
    small = work(with_operators(15), sines(bench.samples))
    pairs = axes * axes / 4  # no faster than the number of pairs, beside what a call costs
    what = f"{axes} x {axes}, 50 Hz sines"
    assert bench.compare(GROUP, what, "2 x 2", work(model, u), small, "<=", pairs + 0.5).acceptable


@pytest.mark.parametrize(("factor", "required"), [(0.01, 25.0), (0.1, 4.0), (10, 1.5)])
def test_growth_with_samples(bench, factor, required, published):
    model, samples = published.hysteresis, round(factor * bench.samples)
    u = sines(samples)
    large = work(model, u)
    small = work(model, sines(bench.samples))
    what = f"{samples:,} samples, 50 Hz sines"
    assert bench.compare(
        GROUP, what, f"{bench.samples:,} samples", large, small, "<=", required, repeats=5
    ).acceptable
