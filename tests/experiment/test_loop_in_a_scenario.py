"""Hysteresis in the loop, identified from the experiments of a scenario."""

import pytest

import hammerstein
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import ElastoSlip, ElectromechanicalDynamics, StackAxis
from hammerstein.errors import InputError
from hammerstein.hysteresis import PrandtlIshlinskii

LOOP = {
    "method": "hysteresis_in_loop",
    "amplitude_v": 36.0,
    "highest_frequency_hz": 1000.0,
    "record_s": 0.05,
    "order": 2,
}
CASCADE = {
    "method": "hammerstein",
    "amplitude_v": 36.0,
    "frequencies_hz": [20.0, 100.0, 300.0],
    "partition": "fitted",
    "operators": 8,
}


def stack(tmp_path, voltages=None):
    """File of a stack of 400 Hz whose resonance falls with the amplitude."""
    stops = ((0.3, 0.9), (0.2, 3.0), (0.1, 12.0))
    axis = StackAxis(
        mass_kg=0.5,
        stiffness_n_per_um=3.16,
        damping_ns_per_m=120.0,
        capacitance_uf=2.0,
        force_n_per_v=1.2,
        stops=tuple(ElastoSlip(stiffness_v_per_uc=k, threshold_uc=r) for k, r in stops),
    )
    straight = PrandtlIshlinskii.from_arrays([0.0], [[[1.0]]])
    dynamics = ElectromechanicalDynamics(axes=(axis,))
    model = hammerstein.HammersteinModel("stack", straight, dynamics, 50.0, ("u",), ("x",), voltages=voltages)
    model.save(tmp_path / "stack.json")
    return str(tmp_path / "stack.json")


def scenario(actuator, *sources, **more):
    compensators = [
        {"label": spec["method"], "law": "hammerstein_inverse", "identification": spec} for spec in sources
    ]
    asked = {
        "question": "Which model follows near a resonance?",
        "actuator": actuator,
        "seed": 3,
        "instruments": {"drive": {"range_v": 100.0}},
        "reference": {"kind": "sine", "amplitude_um": 4.0, "frequency_hz": 300.0},
        "compensators": compensators,
    }
    return asked | more


def errors_um(report):
    """Rms error of the true position by compensator."""
    return {row.compensator: row.rms_true_um for row in report.rows}


def test_a_loop_is_identified_through_the_sensor(tmp_path):
    """A noise of 0.04 um and a lag of 8 degrees leave 0.5 % of a path near the resonance."""
    found = errors_um(hammerstein.run(scenario(stack(tmp_path), LOOP)))
    assert found["hysteresis_in_loop"] < 0.02


@pytest.mark.full
def test_a_cascade_cannot_move_a_resonance(tmp_path):
    """Plays in front of a resonance that stays where it is leave ten times as much."""
    found = errors_um(hammerstein.run(scenario(stack(tmp_path), LOOP, CASCADE)))
    assert found["hysteresis_in_loop"] < 0.1 * found["hammerstein"]


@pytest.mark.full
def test_a_loop_of_positive_voltages_alone(tmp_path):
    """0 to 100 V, at rest at 0 V: its records lie about 50 V, the path in the middle of its reach."""
    middle = stack(tmp_path, Voltages.of([0.0], [0.0], [100.0]))
    more = {"reference": {"kind": "sine", "amplitude_um": 4.0, "offset_um": 15.0, "frequency_hz": 100.0}}
    unipolar = {"instruments": {"drive": {"range_v": [0.0, 100.0]}}}
    found = errors_um(hammerstein.run(scenario(middle, LOOP | {"amplitude_v": 45.0}, **more, **unipolar)))
    assert found["hysteresis_in_loop"] < 0.02


def test_its_experiments_stay_below_half_the_sample_rate(tmp_path):
    with pytest.raises(InputError, match="12000 Hz is not below half the sample rate"):
        hammerstein.run(scenario(stack(tmp_path), LOOP | {"highest_frequency_hz": 12000.0}))
