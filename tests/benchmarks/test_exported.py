"""Exported C against the batch kernel that it repeats, and one sample at a time in C and in Python."""

import ctypes
import gc
import statistics
import time

import numpy as np
import pytest
from cases import sines
from ratios import Row, Work

from hammerstein.experiment.plan import slowness
from hammerstein.export.code import CCode
from hammerstein.export.request import Request
from hammerstein.export.trial import compiler
from hammerstein.model import HammersteinModel

GROUP = "exact_inverse exported as C, 2 x 2, 15 operators, 50 Hz sines"
BUSY = 2.0
"""Times what is required before a step fails, on a usual processor: a time is the machine's too."""


@pytest.fixture(scope="module")
def code(published):
    if compiler() is None:
        pytest.skip("no C compiler here")
    request = Request(source="duo_bimorph_static", law="exact_inverse", sample_time_s=5e-5)
    return CCode(request, published, request.block(published))


def wanted(code, samples):
    return code.model.hysteresis.respond(0.9 * sines(samples))[0]


def test_c_against_the_batch_kernel(bench, code):
    reference = wanted(code, bench.samples)
    with code.library() as library:
        law = library.rest()
        ours = Work(lambda: library.respond(reference, law), reference.shape[1])
        batch = Work(lambda: code.block.respond(reference), reference.shape[1])
        row = bench.compare(GROUP, "C, compiled with -O2", "batch kernel", ours, batch, "<=", 1.5, repeats=5)
    assert row.acceptable


def test_the_worst_step_against_the_median(bench, code):
    """Each step several times, the quickest counts: what the machine does meanwhile is not the law's."""
    reference = wanted(code, bench.fewer(20_000))
    with code.library() as library:
        quickest = np.min([_steps_in_c(code, library, reference) for _ in range(5)], axis=0)
    middle, worst = float(np.median(quickest)), float(quickest.max())
    bench.table.add(Row(GROUP, "C, median step", "its worst step", middle, worst, "ns", worst / middle))
    assert worst > middle


def _steps_in_c(code, library, reference):
    """Time of every step [ns], with that of the call and of the clock taken off."""
    step, law = library.function("step"), library.rest()
    into = np.ascontiguousarray(reference.T)
    out = np.empty(code.shape.leaving)
    place, clock = out.ctypes.data_as(ctypes.c_void_p), time.perf_counter_ns
    rows = [ctypes.c_void_p(row.ctypes.data) for row in into]
    times = np.empty(len(rows))
    gc.disable()
    try:
        for t, row in enumerate(rows):
            begun = clock()
            step(law, row, place)
            times[t] = clock() - begun
    finally:
        gc.enable()
    return times


@pytest.mark.parametrize(
    ("name", "required_ns"),
    [
        ("none", 3000.0),
        ("exact_inverse", 5000.0),
        ("inverse_multiplicative", 10_000.0),
        ("decoupled_inverse", 10_000.0),
        ("hammerstein_inverse", 10_000.0),
    ],
)
def test_a_step_in_python(bench, published, name, required_ns):
    model = published if name != "hammerstein_inverse" else HammersteinModel.load("duo_bimorph")
    law = Request(source="duo_bimorph", law=name, sample_time_s=5e-5).block(model)
    reference = published.hysteresis.respond(0.9 * sines(bench.fewer(20_000)))[0].T.copy()
    state, times = law.rest(), []
    law.step(reference[0], state)
    for sample in reference:
        begun = time.perf_counter_ns()
        _, state = law.step(sample, state)
        times.append(time.perf_counter_ns() - begun)
    middle = statistics.median(times)
    group = "One sample of a law in Python (step)"
    row = Row(
        group, f"{name}, median", "required", middle, required_ns, "ns", middle / required_ns, "<=", 1.0
    )
    assert bench.table.add(row).ratio <= BUSY * max(1.0, slowness())
