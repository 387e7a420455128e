"""Records that cannot tell what is asked of them: noise, small voltages, voltages that never turn."""

import numpy as np
import pytest
import theory
from record_cases import plain

from hammerstein.errors import IdentificationError
from hammerstein.identification.identify import identify
from hammerstein.records.record import Record

QUICK = plain(operators=5, error_curve=False, delay_samples=0)
THRESHOLDS = [[np.array([0.0, 1.0, 3.0])] * 2] * 2
WEIGHTS = [
    [np.array([3.0, 1.0, 0.5]), np.array([0.2, 0.1, 0.0])],
    [np.array([-0.1, 0.1, 0.1]), np.array([4.0, 1.0, 0.5])],
]
TIME_S = 1e-4 * np.arange(6000)
SINE = 10.0 * np.sin(2.0 * np.pi * 5.0 * TIME_S)


def measured(u, noise_um=0.02, seed=0):
    y = theory.prandtl_ishlinskii(u, THRESHOLDS, WEIGHTS)
    return Record(u, y + noise_um * np.random.default_rng(seed).standard_normal(y.shape), 1e-4)


def test_readings_of_noise_are_refused():
    noise = 0.04 * np.random.default_rng(1).standard_normal((2, 6000))
    record = Record([SINE, np.roll(SINE, 700)], noise, 1e-4)
    with pytest.raises(IdentificationError, match="the readings are noise") as caught:
        identify([record], QUICK)
    assert caught.value.exit_code == 4


def test_one_output_of_noise_beside_a_good_one_is_flagged():
    rng = np.random.default_rng(2)
    y = theory.prandtl_ishlinskii([SINE], [THRESHOLDS[0][:1]], [WEIGHTS[0][:1]])
    record = Record([SINE], np.vstack([y, 9.0 * rng.standard_normal(6000)]), 1e-4)
    _, fit = identify([record], QUICK)
    assert any("the error of y2" in flag for flag in fit.flags)


def test_an_input_of_noise_is_named():
    u = np.vstack([SINE, 1e-3 * np.random.default_rng(3).standard_normal(6000)])
    with pytest.raises(IdentificationError, match=r"input u2 is never driven.*remove it"):
        identify([measured(u)], QUICK)


def test_an_input_that_was_driven_too_little_is_said_to_be_untold():
    little = np.vstack([SINE, 0.01 * np.sin(2.0 * np.pi * 7.0 * TIME_S)])
    enough = np.vstack([SINE, 5.0 * np.sin(2.0 * np.pi * 7.0 * TIME_S)])
    said = [" ".join(identify([measured(u)], QUICK)[1].not_identifiable) for u in (little, enough)]
    assert "individual weights of u2: its 0.02 V move" in said[0]
    assert "individual weights of u2" not in said[1]


def test_a_voltage_that_never_turns_tells_no_hysteresis():
    ramp = np.linspace(0.0, 10.0, 6000)
    with pytest.raises(IdentificationError, match="no voltage turns in any record"):
        identify([measured(np.vstack([ramp, 0.5 * ramp]))], QUICK)
    _, fit = identify([measured(np.vstack([SINE, ramp]))], QUICK)
    assert any(text.startswith("hysteresis of u2: its voltage never turns") for text in fit.not_identifiable)


def test_every_input_keeps_its_own_amplitude():
    u = np.vstack([SINE, 0.2 * np.roll(SINE, 700)])
    model, fit = identify([measured(u)], QUICK)
    assert fit.amplitudes_v == pytest.approx((10.0, 2.0), rel=1e-3)
    assert fit.amplitude_v == model.amplitude_v == pytest.approx(10.0, rel=1e-3)
    assert model.provenance["amplitudes_v"] == pytest.approx([10.0, 2.0], rel=1e-3)


def test_dynamics_that_the_records_do_not_tell_are_the_first_thing_said():
    slow = measured(np.vstack([SINE, np.roll(SINE, 700)]))
    known = {"thresholds_v": THRESHOLDS[0][0].tolist(), "error_curve": False, "delay_samples": 0}
    settings = plain(**known, dynamics="second_order")
    _, fit = identify([slow], settings)
    assert fit.kind == "static_hysteresis"
    assert fit.verdict.startswith(
        "You asked for dynamics, but the records do not identify any: THIS MODEL IS STATIC."
    )


def test_a_butterfly_is_flagged_and_not_taken_for_swapped_columns():
    y = theory.prandtl_ishlinskii([SINE], [THRESHOLDS[0][:1]], [WEIGHTS[0][:1]])
    _, fit = identify([Record([SINE], y**2 / 60.0, 1e-4)], QUICK)
    assert any("no rising loop" in flag for flag in fit.flags)
