"""A law in a loop of one's own: the same bits, no garbage, and what is wrong is said."""

import gc
import sys

import numpy as np
import pytest

import hammerstein
from hammerstein.arrays import frozen
from hammerstein.errors import InputError
from hammerstein.examples import stream as example

T = 50e-6


@pytest.fixture(scope="module")
def law():
    model = hammerstein.HammersteinModel.load("duo_bimorph_static")
    return hammerstein.ExactInverse().design(model, range_v=10.0, sample_time_s=T)


def _path(samples=600):
    turn = 2.0 * np.pi * 3.0 * np.arange(samples) / samples
    return 20.0 * np.stack([np.sin(turn), np.sin(2.0 * turn)])


def test_samples_and_blocks_give_the_bits_of_respond(law):
    reference = _path()
    wanted = law.respond(reference)[0]
    one, several = hammerstein.stream(law), hammerstein.stream(law)
    assert (np.stack([one.step(row).copy() for row in reference.T], axis=1) == wanted).all()
    mixed = [several.block(reference[:, :100]), several.step(reference[:, 100])[:, None].copy()]
    mixed.append(several.block(reference[:, 101:]))
    assert (np.hstack(mixed) == wanted).all()


def test_a_stream_goes_on_from_a_state(law):
    reference = _path()
    wanted = law.respond(reference)[0]
    first = hammerstein.stream(law)
    first.block(reference[:, :300])
    kept = law.restore(first.state.as_dict())
    assert (hammerstein.stream(law, kept).block(reference[:, 300:]) == wanted[:, 300:]).all()


def test_no_sample_waits_for_a_compilation():
    """All is compiled when the stream begins, and whatever form a sample has it is the same code."""
    model = hammerstein.HammersteinModel.load("duo_bimorph_static")
    law = hammerstein.ExactInverse().design(model, range_v=10.0, sample_time_s=T)
    loop, path = hammerstein.stream(law), _path(6)
    known = len(law._compiled_step.signatures)
    assert known > 0
    forms = (path[:, 0], path.T[1], path[:, 2].tolist(), path[:, 3].astype(np.float32), frozen(path[:, 4]))
    for sample in forms:
        loop.step(sample)
    assert len(law._compiled_step.signatures) == known


def test_a_step_leaves_no_garbage(law):
    """Nothing for the collector, and no block of memory more, after many steps.

    Another thread may leave something meanwhile; steps would leave it in every round.
    """
    loop, rows = hammerstein.stream(law), np.ascontiguousarray(_path(5000).T)

    def left():
        while gc.collect():  # a cycle may hold the last reference to another one
            pass
        gc.disable()
        try:
            blocks, tracked = sys.getallocatedblocks(), gc.get_count()[0]
            for row in rows:
                loop.step(row)
            return gc.get_count()[0] - tracked, sys.getallocatedblocks() - blocks, gc.collect()
        finally:
            gc.enable()

    left()  # once, for what is made at the first step
    tracked, blocks, garbage = np.min([left() for _ in range(3)], axis=0)
    assert tracked < 10
    assert blocks < 50
    assert garbage == 0


def test_a_bad_sample_changes_nothing(law):
    loop, fresh = hammerstein.stream(law), hammerstein.stream(law)
    loop.step([5.0, 1.0])
    fresh.step([5.0, 1.0])
    for bad in ([np.nan, 0.0], [1.0, 2.0, 3.0], [1.0]):
        with pytest.raises(InputError):
            loop.step(bad)
    assert (loop.step([6.0, 1.0]) == fresh.step([6.0, 1.0])).all()


def test_what_cannot_be_streamed_is_said():
    with pytest.raises(InputError, match="design one first"):
        hammerstein.stream(hammerstein.ExactInverse())


def test_the_example_runs_and_prints_its_histogram(capsys):
    example.main(seconds=0.2)
    said = capsys.readouterr().out
    assert "time a step: median" in said
    counts = [int(line.split()[3]) for line in said.splitlines() if line.startswith("from ")]
    assert sum(counts) == 2 * 400  # two histograms of every step
    assert float(said.rpartition(": ")[2].split()[0]) < 1e-6
