"""Loops in records: against the closed forms of a settled Prandtl-Ishlinskii loop."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import theory
from scipy.signal import lsim

from hammerstein.commands.cli import main
from hammerstein.records.checks import time_mistakes
from hammerstein.records.gains import leads
from hammerstein.records.loops import (
    _path,
    loop_table,
    pair_loops,
    ringing,
    telling_loops,
    widest_cycle,
    without_loops,
)
from hammerstein.records.reading import read_paired_records, read_records
from hammerstein.records.record import Record
from hammerstein.records.turning_points import (
    Excursion,
    dead_band,
    find_cycles,
    noise_rms,
    quantum,
    turning_points,
)
from hammerstein.reporting.figures.loops import chosen_loops

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"

# the printed table of the published actuator, x voltage to x displacement (paper, equations 12 and 13)
R = np.array([0.07, 0.32, 0.74, 1.3, 2, 2.8, 3.67, 4.61, 5.54, 6.5, 7.34, 8.1, 8.8, 9.3, 9.7])
W = np.array(
    [4.3, -0.395, 0.117, 0.657, 0.207, 0.252, 0.605, 0.15, 0.265, 0.229, 0.207, 0.381, 0.411, 0.256, 2.28]
)


def respond(u, r=R, w=W, start=0.0):
    """Textbook play operators, one sample after the other."""
    plays, y = np.full(len(r), start), np.empty(len(u))
    for k, value in enumerate(u):
        plays = np.maximum(value - r, np.minimum(value + r, plays))
        y[k] = w @ plays
    return y


def height(amplitude, r=R, w=W):
    return 2.0 * w @ np.maximum(amplitude - r, 0.0)


def area(amplitude, r=R, w=W):
    return 4.0 * (w * r) @ np.maximum(amplitude - r, 0.0)


def opening(amplitude, r=R, w=W):
    """Falling minus rising branch at mid voltage, from the branch of facts: sum w max(0, u + A - 2 r)."""
    rise = w @ np.maximum(amplitude - 2.0 * r, 0.0)
    return height(amplitude, r, w) - 2.0 * rise


def measured(y, seed=1, noise_um=0.04, step_um=0.04):
    rng = np.random.default_rng(seed)
    return np.round((y + noise_um * rng.standard_normal(y.shape)) / step_um) * step_um


def sine(cycles, samples=400.0, amplitude=10.0, bias=0.0):
    return bias + amplitude * np.sin(2.0 * np.pi * np.arange(int(cycles * samples)) / samples)


def line(*corners):
    """Straight lines through (sample, volt)."""
    samples, volts = np.array(corners).T
    return np.interp(np.arange(int(samples[-1]) + 1), samples, volts)


def triangle(cycles, samples=400, amplitude=10.0, bias=0.0):
    quarters = [0.0, *([amplitude, -amplitude] * (cycles + 1))]
    at = [0, *(samples // 4 + samples // 2 * np.arange(2 * cycles + 2))]
    return bias + line(*zip(at, quarters, strict=True))[: cycles * samples]


def record(u, y, sample_time_s=5e-5):
    return Record(np.atleast_2d(u), np.atleast_2d(y), sample_time_s)


@pytest.mark.parametrize("excitation", [sine, triangle])
@pytest.mark.parametrize("amplitude", [10.0, 5.0])
def test_clean_loop_is_the_closed_form(excitation, amplitude):
    u = excitation(4, amplitude=amplitude)
    loops = loop_table(record(u, respond(u)))
    assert len(loops) == 3
    for loop in loops:
        assert loop.settled
        assert not loop.minor
        assert loop.amplitude_v == pytest.approx(amplitude, rel=1e-9)
        assert loop.height_um == pytest.approx(height(amplitude), rel=1e-9)
        assert loop.width_um == pytest.approx(opening(amplitude), rel=1e-3)
        assert loop.area_v_um == pytest.approx(area(amplitude), rel=1e-3)
        assert loop.closure_um == pytest.approx(0.0, abs=1e-9)
        assert loop.drift_um == pytest.approx(0.0, abs=1e-9)


def last_settled(record):
    return [loop for loop in loop_table(record) if loop.settled][-1]


def test_published_width_is_the_papers():
    u = sine(3)
    loop = last_settled(record(u, respond(u)))
    assert loop.width_percent == pytest.approx(16.7, abs=0.05)
    assert loop.area_v_um == pytest.approx(281.90, abs=0.05)
    assert loop.height_um == pytest.approx(2 * 58.40, abs=0.01)


@pytest.mark.parametrize("excitation", [sine, triangle])
@pytest.mark.parametrize("amplitude", [10.0, 5.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_sensor_noise_and_quantisation_move_nothing(excitation, amplitude, seed):
    u = excitation(6, amplitude=amplitude)
    loops = loop_table(record(u, measured(respond(u), seed)))
    assert len(loops) == 5
    for loop in loops:
        assert loop.settled
        assert -0.001 < loop.height_um / height(amplitude) - 1.0 < 0.006
        assert loop.width_um == pytest.approx(opening(amplitude), abs=0.12)
        assert loop.area_v_um == pytest.approx(area(amplitude), rel=0.004)
        assert loop.closure_um == pytest.approx(0.0, abs=0.1)
        assert loop.drift_um == pytest.approx(0.0, abs=0.02)


def test_the_size_of_the_motion_changes_no_part_of_a_loop():
    u, size = sine(3), 2.0**-13  # a power of two, so that no rounding differs
    y = measured(respond(u))
    for loop, small in zip(loop_table(record(u, y)), loop_table(record(u, size * y)), strict=True):
        assert small.settled == loop.settled
        for told in ("height_um", "width_um", "area_v_um", "closure_um", "drift_um"):
            assert getattr(small, told) == pytest.approx(size * getattr(loop, told), rel=1e-9)


def test_a_loop_little_higher_than_the_noise():
    """3.5 um, as a cross-coupling: peak to peak of the raw samples would be 7 percent too much."""
    u = sine(21)
    clean = 0.03 * respond(u)
    loops = loop_table(record(u, measured(clean)))
    heights = np.array([loop.height_um for loop in loops])
    assert len(loops) == 20
    assert all(loop.settled for loop in loops)
    assert heights.mean() == pytest.approx(0.03 * height(10.0), rel=0.03)
    assert np.std([loop.closure_um for loop in loops]) < 0.04
    assert np.mean([loop.area_v_um for loop in loops]) == pytest.approx(0.03 * area(10.0), rel=0.02)


@pytest.mark.parametrize("samples", [41.3, 133.33, 200.37])
@pytest.mark.parametrize("noise_um", [0.0, 0.04])
def test_period_of_no_whole_number_of_samples(samples, noise_um):
    u = sine(6, samples)
    y = respond(u) if noise_um == 0 else measured(respond(u))
    loops = loop_table(record(u, y))
    missed = 10.0 * (1.0 - np.cos(np.pi / samples))  # a tip between two samples is cut off by as much
    chord = (2.0 * np.pi / samples) ** 2  # and an arc between samples becomes a chord
    assert len(loops) == 5
    for loop in loops:
        assert loop.settled
        assert loop.amplitude_v == pytest.approx(10.0, abs=missed)
        assert loop.height_um == pytest.approx(height(10.0), rel=missed / 2.0 + 4.0 * noise_um / 100.0)
        assert loop.area_v_um == pytest.approx(area(10.0), rel=chord + 0.002)
        assert loop.closure_um == pytest.approx(0.0, abs=0.05 + 5.0 * noise_um)


def test_triangle_whose_samples_miss_the_tips_still_settles():
    phase = np.arange(1200) / 133.33 % 1.0
    u = np.interp(phase, [0.0, 0.25, 0.75, 1.0], [0.0, 10.0, -10.0, 0.0])
    assert all(loop.settled for loop in loop_table(record(u, measured(respond(u)))))


def test_biased_loop_with_asymmetric_branches():
    """A drive from 0 to 12 V around 6 V, with a bump on the rising branch alone."""
    r, w = np.array([0.5, 2.0, 4.0]), np.array([3.0, 2.0, 1.0])
    u = sine(4, amplitude=6.0, bias=6.0)
    y = respond(u, r, w, start=6.0) - 200.0
    bump = np.where(np.gradient(u) > 0, np.maximum(0.0, 6.0 - np.abs(u - 6.0)), 0.0)
    plain = last_settled(record(u, y))
    bent = last_settled(record(u, y + bump))
    assert plain.mid_v == pytest.approx(6.0)
    assert plain.area_v_um == pytest.approx(area(6.0, r, w), rel=1e-3)
    assert bent.area_v_um == pytest.approx(area(6.0, r, w) - 36.0, rel=2e-3)  # triangle under the bump
    assert bent.width_um == pytest.approx(plain.width_um - 6.0, rel=2e-3)
    assert bent.settled


def test_a_straight_line_has_no_area_though_its_samples_miss_the_tips():
    """Its polygon is closed by itself, wherever it ends."""
    u = np.interp(np.arange(95) / 23.7 % 1.0, [0.0, 0.25, 0.75, 1.0], [0.0, 10.0, -10.0, 0.0])
    loops = loop_table(record(u, 5.0 * u))
    assert max(abs(u[loop.stop] - u[loop.start]) for loop in loops) > 0.1
    np.testing.assert_allclose([loop.area_v_um for loop in loops], 0.0, atol=1e-9)


def test_leading_output_has_negative_area_and_width():
    u = sine(3)
    x = respond(u)
    loop = last_settled(record(x, u))
    assert loop.area_v_um == pytest.approx(-area(10.0), rel=1e-3)
    assert loop.width_percent < -10.0


def test_start_from_rest_is_no_settled_cycle():
    """From 0 V up and down a record starts on the level of its turns, yet its first cycle is open."""
    u = line((0, 0), (200, 10), (400, 0), (600, 10), (800, 0), (1000, 10), (1200, 0))
    loops = loop_table(record(u, respond(u)))
    assert [loop.settled for loop in loops] == [False, True, True]
    virgin = W @ np.maximum(10.0 - R, 0.0)
    back = W @ np.maximum(10.0 - 2.0 * R, 0.0)  # falls by as much as the settled branch rises
    assert loops[0].closure_um == pytest.approx(virgin - back, rel=1e-9)
    assert loops[1].area_v_um == pytest.approx(area(5.0), rel=1e-3)


def test_the_cycle_behind_the_one_from_rest_is_settled_if_no_other_follows():
    """The largest loop of a record of falling ones was left out, as if it drifted like the first one."""
    u = line((0, 0), (200, 10), (400, 0), (600, 10), (800, 0), (1000, 8), (1200, 0), (1400, 6), (1600, 0))
    loops = loop_table(record(u, respond(u)))
    assert [loop.settled for loop in loops] == [False, True, True, True]
    assert loops[1].area_v_um == pytest.approx(area(5.0), rel=1e-3)
    assert abs(loops[1].drift_um) < 1e-9


@pytest.mark.parametrize(("part", "settled"), [(0.003, True), (0.007, False)])
def test_a_cycle_that_drifts_by_half_a_percent_of_its_height_has_not_settled(part, settled):
    """Each cycle is higher than the one before it by a part of its height."""
    u = sine(4)
    y = 5.0 * u + part * 100.0 * np.floor(np.arange(len(u)) / 400 - 0.25)
    assert {loop.settled for loop in loop_table(record(u, y))[1:-1]} == {settled}


def test_sharp_tips_are_not_rounded_off():
    u = triangle(6)
    for loop in loop_table(record(u, measured(5.0 * u))):
        assert loop.height_um == pytest.approx(100.0, rel=0.003)
        assert loop.width_um == pytest.approx(0.0, abs=0.1)


def test_one_cycle_from_rest_is_not_settled():
    u = line((0, 0), (200, 10), (400, 0))
    (loop,) = loop_table(record(u, respond(u)))
    assert not loop.settled
    assert loop.drift_um == loop.closure_um


def test_symmetric_drive_from_rest_leaves_the_first_quarter_out():
    u = sine(2)
    first = loop_table(record(u, respond(u)))[0]
    assert (first.start, first.turn, first.stop) == (100, 300, 500)
    assert first.settled


def test_first_rise_alone_holds_no_loop():
    u = sine(0.7)
    whole = record(u, respond(u))
    assert loop_table(whole) == []


def test_a_transient_is_not_settled_until_it_is():
    u = sine(8)
    decay = 20.0 * np.exp(-np.arange(len(u)) / 500.0)
    loops = loop_table(record(u, measured(respond(u) + decay)))
    settled = [loop.settled for loop in loops]
    assert settled == sorted(settled)
    assert not settled[0]
    assert settled[-1]
    assert not any(loop.settled for loop in loop_table(record(u[:1100], (respond(u) + decay)[:1100])))


def test_drift_is_the_creep_of_a_cycle():
    u = sine(5)
    creep = 0.3 * np.arange(len(u)) / 400.0
    for loop in loop_table(record(u, measured(respond(u) + creep))):
        assert loop.drift_um == pytest.approx(0.3, abs=0.02)
        assert loop.closure_um == pytest.approx(0.3, abs=0.1)


def test_plateaus_add_no_turns_and_no_area():
    u = line(
        (0, 0), (100, 10), (180, 10), (300, -10), (330, -10), (450, 10), (500, 10), (620, -10), (700, -10)
    )
    u = np.concatenate([np.zeros(60), u, line((0, -10), (100, 10), (150, 10))])
    loops = loop_table(record(u, measured(respond(u))))
    assert [loop.turn for loop in loops] == [360, 680]
    for loop in loops:
        assert loop.settled
        assert loop.area_v_um == pytest.approx(area(10.0), rel=0.004)


def test_several_amplitudes_in_one_record():
    parts = [sine(2, amplitude=a) for a in (10.0, 7.0, 4.0)]
    u = np.concatenate(parts)
    loops = loop_table(record(u, measured(respond(u))))
    for amplitude in (10.0, 7.0, 4.0):
        equal = [
            loop for loop in loops if abs(loop.amplitude_v - amplitude) < 0.01 and loop.stop % 800 == 500
        ]
        assert equal
        assert all(loop.area_v_um == pytest.approx(area(amplitude), rel=0.01) for loop in equal)
        assert all(loop.settled for loop in equal)


def test_minor_loop_on_a_branch_is_a_loop_of_its_own():
    """Wiping out: the major loop is what it is without the excursion from 4 V to 1 V and back."""
    u = line((0, 0), (500, 10), (1500, -10), (2200, 4), (2350, 1), (2800, 10), (3800, -10), (4800, 10))
    loops = loop_table(record(u, respond(u)))
    major, minor, last = loops
    assert [loop.minor for loop in loops] == [False, True, False]
    assert (minor.start, minor.turn, minor.stop) == (2200, 2350, 2500)
    assert minor.amplitude_v == pytest.approx(1.5)
    assert minor.height_um == pytest.approx(height(1.5), rel=1e-6)
    assert minor.area_v_um == pytest.approx(area(1.5), rel=1e-3)
    assert minor.settled
    assert major.area_v_um == pytest.approx(area(10.0), rel=1e-3)
    assert major.width_um == pytest.approx(last.width_um, rel=1e-3)
    assert major.drift_um == pytest.approx(0.0, abs=1e-6)
    assert major.settled


def test_modulated_amplitude_gives_open_cycles():
    n = np.arange(4000)
    u = 10.0 * np.sin(2.0 * np.pi * n / 400) * (1.0 - 0.6 * n / 4000)
    loops = loop_table(record(u, measured(respond(u))))
    assert len(loops) == 9
    assert not any(loop.settled for loop in loops)
    swings = [loop.amplitude_v for loop in loops]
    assert swings == sorted(swings, reverse=True)
    for loop in loops:  # branches are compared at one voltage, though each has another middle
        assert loop.width_um == pytest.approx(opening(loop.amplitude_v), rel=0.1, abs=0.3)


def test_every_driven_pair_is_listed_in_order():
    u = np.vstack([sine(3), np.full(1200, 0.3)])
    x = respond(u[0])
    loops = loop_table(Record(u, [x, 0.1 * x], 5e-5, ("ux", "uy"), ("x", "y")))
    assert [(loop.input, loop.output) for loop in loops] == [("ux", "x")] * 2 + [("ux", "y")] * 2
    assert loops[2].height_um == pytest.approx(0.1 * loops[0].height_um)


def test_two_inputs_in_motion_draw_no_loop_of_a_pair():
    u = np.vstack([sine(3), np.roll(sine(3), 100)])
    both = Record(u, [respond(u[0]) + respond(u[1]), respond(u[1])], 5e-5, ("ux", "uy"), ("x", "y"))
    assert loop_table(both) == []
    assert "ux and uy move together" in without_loops(both)
    in_turn = np.vstack([np.append(sine(3), 0 * sine(3)), np.append(0 * sine(3), sine(3))])
    loops = loop_table(Record(in_turn, [respond(in_turn[0]), respond(in_turn[1])], 5e-5))
    assert {(loop.input, loop.start < 1200) for loop in loops} == {("u1", True), ("u2", False)}


def test_a_lag_is_positive_whichever_way_the_output_moves():
    u = sine(3)
    up, down = (last_settled(record(u, sign * respond(u))) for sign in (1.0, -1.0))
    assert down.width_percent == pytest.approx(up.width_percent)
    assert down.area_v_um == pytest.approx(area(10.0), rel=1e-3)


def test_a_voltage_that_jumps_draws_no_loop():
    u = np.repeat(np.where(np.random.default_rng(1).random(100) > 0.5, 10.0, -10.0), 9)
    jumping = record(u, respond(u))
    assert loop_table(jumping) == []
    assert "jumps between its levels" in without_loops(jumping)


def test_a_voltage_measured_with_noise_has_the_same_loops():
    rng = np.random.default_rng(3)
    u = sine(5)
    noisy = np.round((u + 0.02 * rng.standard_normal(u.size)) / 0.005) * 0.005
    loops = loop_table(record(noisy, measured(respond(u))))
    assert len(loops) == 4
    for loop in loops:
        assert loop.settled
        assert loop.area_v_um == pytest.approx(area(10.0), rel=0.01)
        assert loop.width_um == pytest.approx(opening(10.0), abs=0.2)


def branches(whole, loop):
    """Voltage and output of a loop as it is measured, minor loops left out: on the way there, and back."""
    u, y = whole.u_v[0], whole.y_um[0]
    excursion = Excursion(loop.start, loop.turn, loop.stop, loop.minor)
    path = _path(u, y, excursion, [other for other in find_cycles(u).excursions if other.minor], 0.0)
    there, back = slice(0, path.turn + 1), slice(path.turn, None)
    return path.u[there], path.y[there], path.u[back], path.y[back]


def test_branches_are_the_closed_form():
    u = sine(3)
    whole = record(u, respond(u))
    first_v, first_um, second_v, second_um = branches(whole, last_settled(whole))
    rising_v, rising_um, falling_v, falling_um = (
        (first_v, first_um, second_v, second_um)
        if first_v[-1] > first_v[0]
        else (second_v, second_um, first_v, first_um)
    )
    theory = np.maximum(rising_v[:, None] + 10.0 - 2.0 * R, 0.0) @ W - height(10.0) / 2.0
    np.testing.assert_allclose(rising_um, theory, atol=1e-9)
    np.testing.assert_allclose(falling_um, -np.interp(-falling_v, rising_v, rising_um), atol=2e-3)
    assert np.all(np.diff(rising_v) >= 0)
    assert np.all(np.diff(falling_v) <= 0)


def test_branches_leave_minor_loops_out():
    u = line((0, 0), (500, 10), (1500, -10), (2200, 4), (2350, 1), (2800, 10))
    whole = record(u, respond(u))
    _, _, rising_v, _ = branches(whole, loop_table(whole)[0])
    assert np.all(np.diff(rising_v) >= 0)
    assert rising_v[-1] == 10.0


@pytest.mark.parametrize("noise_v", [0.0, 0.05])
def test_turning_points_under_noise_and_plateaus(noise_v):
    rng = np.random.default_rng(5)
    u = line((0, 2), (300, 2), (500, 6), (700, 6), (1000, -3), (1200, 5), (1500, 0))
    points = turning_points(u + noise_v * rng.standard_normal(u.size))
    assert len(points) == 5
    assert points[0] <= 310
    assert 490 <= points[1] <= 700
    np.testing.assert_allclose(points[2:], [1000, 1200, 1500], atol=12)


def test_a_straight_line_and_a_constant_have_no_turns():
    assert turning_points(np.linspace(0.0, 5.0, 50)).tolist() == [0, 49]
    assert turning_points(np.zeros(50)).tolist() == [0, 49]
    assert find_cycles(np.zeros(50)).excursions == ()


@pytest.mark.parametrize("samples", [50, 200, 400])
def test_noise_estimate_ignores_the_signal(samples):
    rng = np.random.default_rng(2)
    u = sine(8000 / samples, samples)
    assert noise_rms(u) < 2e-3
    assert noise_rms(respond(u)) < 0.04  # of 117 um: its corners are no noise
    assert noise_rms(u + 0.05 * rng.standard_normal(u.size)) == pytest.approx(0.05, rel=0.06)


def test_noise_is_told_from_20_samples_on():
    noise = np.random.default_rng(5).standard_normal(20)
    assert noise_rms(noise) > 0.2
    assert noise_rms(noise[:-1]) == 0.0


def test_two_levels_are_no_lattice():
    assert quantum([0.0, 0.3, 0.3, 0.0]) == 0.0


def test_dead_band_covers_noise_and_converter():
    rng = np.random.default_rng(4)
    noise = rng.standard_normal(100_000)
    small = np.linspace(0.0, 100.0, noise.size) + noise
    assert dead_band(small) > np.ptp(noise)
    assert dead_band(noise) == pytest.approx(0.25 * np.ptp(noise))  # a voltage that switches is no noise
    steps = 0.005 * np.round(np.linspace(0.0, 1000.0, 5000))
    assert quantum(steps) == pytest.approx(0.005)
    assert dead_band(steps) > 0.005


def test_measured_actuator_settles_and_lags():
    folder = DATA / "dbo_piezo_micromanipulator"
    if not folder.is_dir():
        pytest.skip("measured records are not beside the repository")
    (whole,) = read_records([folder / "Model_Vi_Do.dat"], inputs=["1"], outputs=["5"], rate_hz=200.0)
    loops = loop_table(whole)
    assert len(loops) == 39  # 8027 samples of 200 a period, less the way to the first turn
    assert all(loop.settled for loop in loops)
    assert all(loop.samples == 200 for loop in loops)
    assert all(loop.width_percent == pytest.approx(22.6, abs=0.7) for loop in loops)
    assert leads([whole]) == ()


def test_measured_magnetic_loops_are_closed():
    folder = DATA / "ja_magnetic_loops"
    if not folder.is_dir():
        pytest.skip("measured records are not beside the repository")
    voltages = sorted(folder.glob("*_H_*.mat"))
    assert len(voltages) == 5
    for path in voltages:
        for loop in (
            read
            for whole in read_paired_records(
                path, folder / path.name.replace("_H_", "_B_"), axes=("sample", "experiment"), rate_hz=1.0
            )
            for read in pair_loops(whole, 0, 0)
        ):
            assert loop.settled
            assert loop.area_v_um > 0


def test_a_cycle_that_does_not_close_has_not_settled():
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1600) / 400)
    y = theory.prandtl_ishlinskii([u], [[np.array([0.0, 1.0, 3.0])]], [[np.array([3.0, 1.0, 0.5])]])
    y = y + 8.0 * np.exp(-np.arange(1600) / 60.0)  # what rings off in the first cycle
    table = [loop for loop in loop_table(Record([u], y, 1e-3)) if not loop.minor]
    assert [loop.settled for loop in table] == [False, *[True] * (len(table) - 1)]
    assert abs(table[0].closure_um) > 10 * abs(table[-1].closure_um)


@pytest.mark.parametrize(("cycles", "noise", "settled"), [(4, 0.0, True), (2, 0.05, False)])
def test_a_multisine_behind_slow_loops_is_not_listed(cycles, noise, settled):
    """Not beside settled loops, nor where the noise of a faint cross-coupling settles none."""
    phases = np.random.default_rng(1).uniform(0.0, 6.0, 60)
    period = sum(
        np.sin(2.0 * np.pi * k * np.arange(1000) / 1000 + phase) for k, phase in enumerate(phases, 1)
    )
    period *= 9.0 / np.abs(period).max()
    slow = np.arange(2000 * cycles)
    u = np.concatenate([10.0 * np.sin(2.0 * np.pi * slow / 2000), np.tile(period, 4)])
    y = respond(u)
    y += noise * np.ptp(y) * np.random.default_rng(2).standard_normal(len(u))
    loops = loop_table(Record([u], [y], 5e-5))
    assert (
        any(loop.settled and loop.start >= len(slow) for loop in loops) == settled
    )  # of its periods, by chance
    shown = telling_loops(loops)
    assert {loop.settled for loop in shown} == {settled}
    assert [loop.amplitude_v for loop in shown] == pytest.approx([10.0] * len(shown), rel=0.3)
    assert 1 <= len(shown) <= 5


def test_the_loop_that_is_drawn_is_the_settled_one_of_the_output_that_answers():
    """The second input moves the first output by its noise alone, whose last cycle leads elsewhere."""
    swing = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)
    u = np.concatenate([swing, 4.0 * np.sin(2.0 * np.pi * np.arange(400) / 100), np.zeros(200)])
    faint = 0.5 * np.random.default_rng(3).standard_normal(len(u))
    loops = loop_table(Record([0.0 * u, u], [faint, respond(u)], 5e-5))
    drawn = list(chosen_loops(loops))
    assert {(loop.output, loop.settled) for loop in drawn} == {("y2", True)}
    assert drawn[0].amplitude_v == pytest.approx(10.0, rel=1e-3)


def test_the_widest_cycle_is_one_that_closes():
    """The cycle that leads over to another signal turns as wide, but ends where that one first turns."""
    slow, u = 400, 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)
    after = 6.0 * np.sin(2.0 * np.pi * np.arange(400) / 100)
    u = np.concatenate([u, after])
    record = Record([u], [u], 5e-5)
    widest = widest_cycle([record], 0)
    assert widest is not None
    part = widest[1]
    assert part.stop - 1 - part.start == slow
    assert record.u_v[0, part][[0, -1]] == pytest.approx([10.0, 10.0], abs=1e-9)


@pytest.mark.parametrize("apart", [True, False])
def test_a_triangle_is_drawn_and_not_a_multisine_of_larger_swing(apart):
    """Of triangles at 1 and 5 Hz the slow one, in one record with the multisine or in a record of its own."""
    n = np.arange(4000)
    triangles = np.concatenate(
        [8.0 * (2.0 / np.pi) * np.arcsin(np.sin(2 * np.pi * n / p)) for p in (1000, 200)]
    )
    generator = np.random.default_rng(2)
    lines = [np.sin(2.0 * np.pi * f * n / 4000 + generator.uniform(0.0, 6.0)) for f in range(1, 40)]
    rough = 10.0 * sum(lines) / np.abs(sum(lines)).max()
    parts = [triangles, rough] if apart else [np.concatenate([triangles, rough])]
    i, part = widest_cycle([Record([u], [u], 1e-3) for u in reversed(parts)], 0)
    assert i == len(parts) - 1
    assert part.stop - 1 - part.start == pytest.approx(1000, abs=2)


def test_noise_that_could_hide_the_closure_settles_no_lone_loop():
    """Nothing repeats the loop: that it closes within a large noise says nothing."""
    u = 10.0 * np.cos(2.0 * np.pi * np.arange(401) / 400)
    noise = np.random.default_rng(4).normal(0.0, 1.0, 401)
    for share, settled in ((0.0, True), (0.01, True), (0.1, False)):
        y = u + share * np.ptp(u) * np.where(np.arange(401) % 400 == 0, 0.0, noise)
        (loop,) = (found for found in loop_table(Record([u], [y], 1e-3)) if not found.minor)
        assert loop.settled == settled, share


def test_a_slow_line_that_leads_says_nothing_against_a_strong_one_that_lags():
    """A soft actuator was refused as swapped: its slower half of the power led by 2.5 degrees."""
    t = 1e-3 * np.arange(8000)
    slow, fast = 2.0 * np.pi * 1.0 * t, 2.0 * np.pi * 5.0 * t
    u = 6.0 * np.sin(slow) + 5.0 * np.sin(fast)
    y = 12.0 * np.sin(slow + np.radians(2.5)) + 6.0 * np.sin(fast - np.radians(52.0))
    assert leads([Record([u], [y], 1e-3)]) == ()
    assert leads([Record([u], [2.0 * (6.0 * np.sin(slow + 0.1) + 5.0 * np.sin(fast + 0.1))], 1e-3)]) == (
        (0, 0),
    )


def test_a_clock_that_jitters_has_no_gaps():
    """Half of the steps are short, some are long, and none of them lasts: 8,104 gaps were told."""
    generator = np.random.default_rng(1)
    steps = 1e-3 * (0.4 + generator.exponential(0.6, 5000))
    jittered = np.cumsum(steps)
    [mistake] = time_mistakes("t", jittered, np.arange(2, 5002))
    assert "non-uniform time" in mistake.what
    late = 1e-3 * np.arange(5000) + 0.02 * (np.arange(5000) > 3000)
    [mistake] = time_mistakes("t", late, np.arange(2, 5002))
    assert "gap of" in mistake.what


@pytest.mark.parametrize("parts", [("morning",), ("morning", "evening")])
def test_the_table_of_loops_fits_80_columns(tmp_path, capsys, monkeypatch, parts):
    """Also for long file names, a minor loop and numbers of many digits; a single file is in the title."""
    monkeypatch.setenv("COLUMNS", "300")
    t = np.arange(4000) / 4000
    u = 10.0 * np.sin(2.0 * np.pi * 4.0 * t) * np.where(t < 0.75, 1.0, 0.123)
    y = 123.456 * u + 1e-4 * np.cos(2.0 * np.pi * t)
    paths = [tmp_path / f"record_of_a_long_{part}.csv" for part in parts]
    for k, path in enumerate(paths, start=1):
        table = np.stack([t, u, k * y], axis=1)
        np.savetxt(path, table, delimiter=",", header="time_s,u_x,x", comments="")
    with pytest.raises(SystemExit) as caught:
        main(
            [
                "loops",
                *map(str, paths),
                "--inputs",
                "u_x",
                "--outputs",
                "x",
                "--time",
                "time_s",
                "--units",
                "um",
                "--out",
                str(tmp_path / "o"),
            ]
        )
    said = capsys.readouterr().out
    assert not caught.value.code
    lines = said[said.index("Loops") :].splitlines()
    rows = [k for k, line in enumerate(lines) if line.rstrip().endswith(("yes", "no"))]
    assert rows
    table = lines[: rows[-1] + 1]
    assert [line for line in table if len(line.rstrip()) > 80] == []
    swing = 3 if len(parts) > 1 else 2
    assert {lines[k].split()[swing] for k in rows if "minor" not in lines[k]} == {"20"}  # from -10 to 10 V
    assert (lines[0].strip() == "Loops of record_of_a_long_morning.csv") == (len(parts) == 1)


def test_inputs_that_never_move_alone_are_not_measured(monkeypatch):
    """Thousands of loops of a multisine on three inputs took a minute, and none was shown."""
    t = np.arange(2000) / 1000.0
    u = np.array([np.sin(2.0 * np.pi * 5.0 * t), np.sin(2.0 * np.pi * 7.0 * t)])
    monkeypatch.setattr("hammerstein.records.loops.pair_loops", lambda *_: pytest.fail("measured"))
    assert loop_table(Record(u, u, 1e-3)) == []


def test_a_loop_that_rings_is_told_and_one_of_hysteresis_is_not():
    """Plays in front of 190 Hz: every corner of a triangle starts ringing, whose width is by chance."""
    turn = np.arange(3000) / 1000.0
    u, w = 50.0 * (4.0 * np.abs((turn + 0.75) % 1.0 - 0.5) - 1.0), 2.0 * np.pi * 190.0
    y = lsim(([w * w], [1.0, 0.04 * w, w * w]), respond(u), 5e-5 * np.arange(len(u)))[1]
    rung, still = Record([u], [y], 5e-5), Record([u], [respond(u)], 5e-5)
    said = re.match(r"y1 and u1: the output rings near (\d+) Hz", ringing(rung, loop_table(rung)))
    assert float(said[1]) == pytest.approx(200.0, rel=0.05)
    noisy = replace(still, y_um=still.y_um + np.random.default_rng(0).normal(size=still.y_um.shape))
    for record in (still, noisy):
        assert ringing(record, loop_table(record)) is None


def test_small_loops_that_turn_backwards_are_not_shown_beside_wide_ones():
    """A multisine near a resonance makes them by the dozen, and some repeat."""
    turn = np.arange(1200) / 400
    u, y = 10.0 * np.sin(2.0 * np.pi * turn), np.sin(2.0 * np.pi * turn - 0.2)
    (wide, *_) = loop_table(Record([u], [y], 5e-5))
    small = replace(wide, amplitude_v=2.0, width_um=-0.5 * wide.height_um)
    assert telling_loops([wide, small]) == [wide]
    assert telling_loops([small]) == [small]  # that of swapped columns is still seen


def test_the_frequency_of_a_ring_that_decays_is_that_of_its_resonance():
    """Most of a branch has no ring left; what remains there is the bend of hysteresis."""
    t = 5e-5 * np.arange(4000)
    u = 50.0 * (1.0 - 4.0 * np.abs((5.0 * t + 0.5) % 1.0 - 0.5))
    ring = np.exp(-0.05 * 2.0 * np.pi * 180.0 * (t % 0.1)) * np.sin(2.0 * np.pi * 180.0 * (t % 0.1))
    record = Record([u], [u + 1e-3 * u**3 / 50.0 + 3.0 * ring], 5e-5)
    said = re.match(r"y1 and u1: the output rings near (\d+) Hz", ringing(record, loop_table(record)))
    assert float(said[1]) == pytest.approx(180.0, rel=0.05)
