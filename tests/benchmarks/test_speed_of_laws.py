"""Compensators against the forward model, and the whole experiment against a block diagram."""

from dataclasses import replace

import control
import numpy as np
import pytest
from cases import SAMPLE_TIME_S, sines
from ratios import Work
from references import experiment_diagram

from hammerstein.blocks.instruments import standard_noise
from hammerstein.compensators.exact.inverse import ExactInverseLaw
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.experiment.measure import rows_of
from hammerstein.experiment.set_up import set_up
from hammerstein.hysteresis import Asymmetric, DeadZones, Pair, PrandtlIshlinskii
from hammerstein.scenario import Scenario

LAWS = "Compensators, 2 x 2, 15 operators, 50 Hz sines (ratio: times the forward model)"
STEPS = "Whole experiment against the sum of its steps (ratio: times their sum)"
ZONES = "Asymmetric, 2 x 2, 15 operators and 3 dead-zones a pair, 50 Hz sines"
EXPERIMENT = "Whole experiment: reference, compensator, drive, hysteresis, dynamics, sensor, metrics"


def against_forward(bench, law, model, name, required):
    """The law follows what the forward model answers to the sines: both work on the same movement."""
    u = 0.9 * sines(bench.samples)
    wanted = model.hysteresis.respond(u)[0]
    ours = Work(lambda: law.respond(wanted), u.shape[1])
    forward = Work(lambda: model.hysteresis.respond(u), u.shape[1])
    assert bench.compare(LAWS, name, "forward model", ours, forward, "<=", required, repeats=5).acceptable


def test_exact_inverse_against_the_forward_model(bench, published):
    against_forward(bench, ExactInverseLaw(published, 10.0), published, "exact_inverse", 9.0)


def test_inverse_multiplicative_against_the_forward_model(bench, published):
    law = InverseMultiplicativeLaw(published, 10.0, SAMPLE_TIME_S)
    against_forward(bench, law, published, "inverse_multiplicative", 10.0)


def plays_from_zero(model):
    """The same weights, with thresholds from 0 as identification has them beside dead-zones."""
    rows = model.hysteresis.pairs
    return PrandtlIshlinskii(
        [[Pair(np.append(0.0, p.thresholds_v[1:]), p.weights_um_per_v) for p in row] for row in rows]
    )


@pytest.mark.parametrize("of", ["forward model", "exact_inverse"])
def test_dead_zones_cost_at_most_half_as_much_again(bench, published, of):
    u, plays = 0.9 * sines(bench.samples), plays_from_zero(published)
    bends = 0.02 * plays.gain(10.0)
    bent = Asymmetric(plays, [[DeadZones([-5.0, 0.0, 5.0], [b, -b, b]) for b in row] for row in bends])

    def work(block):
        if of == "forward model":
            return Work(lambda: block.respond(u), u.shape[1])
        law, wanted = ExactInverseLaw(replace(published, hysteresis=block), 10.0), block.respond(u)[0]
        return Work(lambda: law.respond(wanted), u.shape[1])

    row = bench.compare(ZONES, of, "plays alone", work(bent), work(plays), "<=", 1.5, repeats=5)
    assert row.acceptable


def circle(samples, law="inverse_multiplicative"):
    """A 40 um circle of 50 Hz on the packaged actuator, compensated with a law of an identified model."""
    cycles = samples // 400
    measure = {"settle_cycles": 2, "measured_cycles": cycles - 2}
    identified = {"label": "tested", "law": law, "identification": {"frequency_hz": 50.0}}
    reference = {"kind": "circle", "radius_um": 40.0, "frequency_hz": 50.0}
    return Scenario.model_validate(
        {
            "question": "How fast is the whole loop?",
            "actuator": "duo_bimorph",
            "reference": reference,
            "measure": measure,
            "compensators": [identified],
        }
    )


def test_whole_experiment_against_a_block_diagram(bench):
    setup = set_up(circle(bench.samples))
    case = next(setup.cases())
    response = setup.simulate(case)
    few = slice(0, bench.fewer(2000))
    time_s = response.time_s[few]
    diagram = experiment_diagram(setup.plant, setup.laws[case.label])
    drawn = standard_noise(np.random.default_rng(case.seed(setup.scenario.seed)), *response.reading_um.shape)
    wires = np.concatenate([response.reference_um, drawn])[:, few]

    def simulated():
        return control.input_output_response(diagram, time_s, wires).outputs

    # Where rounding decides between two steps of a converter, the two may differ by one step.
    away = np.abs(simulated() - response.reading_um[:, few])
    assert np.median(away) < 1e-9
    assert away.max() < 1.5 * setup.plant.instruments.sensor.resolution_um
    ours = Work(lambda: rows_of(setup, case), response.drive_v.shape[1])
    other = Work(simulated, time_s.size)
    what = f"circle, {response.drive_v.shape[1]:,} samples"
    assert bench.compare(
        EXPERIMENT, what, "control.interconnect", ours, other, ">=", 500.0, repeats=5
    ).acceptable


@pytest.mark.parametrize("law", ["exact_inverse", "inverse_multiplicative"])
def test_whole_experiment_against_its_steps(bench, law):
    """What a run costs beside its steps: memory, checks, figures of merit."""
    setup = set_up(circle(bench.samples, law))
    case = next(setup.cases())
    run, plant, tested = setup.simulate(case), setup.plant, setup.laws[case.label]
    filtered, generator = plant.block.respond(run.hysteresis_um)[0][2:], np.random.default_rng(0)

    def loops():
        tested.respond(run.reference_um)
        plant.model.static_response(run.drive_v)
        plant.block.respond(run.hysteresis_um)

    def steps():
        case.signal.sample(run.time_s, 2)
        loops()
        plant.instruments.drive.apply(run.requested_v)
        plant.instruments.sensor.read(filtered, generator)

    samples = run.drive_v.shape[1]
    ours, what = Work(lambda: rows_of(setup, case), samples), f"{law}, figures of merit included"
    for against, call, limit in (
        ("law, hysteresis, dynamics", loops, None),
        ("reference, law, drive, hysteresis, dynamics, sensor", steps, 1.6),
    ):
        other = Work(call, samples)
        assert bench.compare(STEPS, what, against, ours, other, "<=", limit, repeats=7).acceptable
