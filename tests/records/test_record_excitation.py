"""How the inputs of a record were driven, and outputs that run ahead of them: dead start, swapped columns."""

from __future__ import annotations

import numpy as np
import pytest
from record_cases import N, U, X, message

from hammerstein.records.gains import lag_rad, leads, refuse_swapped
from hammerstein.records.record import Record, dead_start, moves_while_held


class TestDriven:
    def test_dead_start_under_noise(self):
        rng = np.random.default_rng(2)
        u = np.concatenate([np.zeros(80), U]) + 3.0
        x = np.concatenate([np.zeros(80), X]) - 95.0
        assert dead_start(Record([u], [x + 0.04 * rng.standard_normal(x.size)], 5e-3)) == 80

    def test_dead_start_of_a_noisy_voltage(self):
        rng = np.random.default_rng(3)
        u = np.concatenate([np.zeros(80), U]) + 0.005 * rng.standard_normal(N + 80)
        assert dead_start(Record([u], [u], 5e-3)) == pytest.approx(80, abs=3)

    @pytest.mark.parametrize("power", [1, 2, 3])
    @pytest.mark.parametrize("held", [0, 7, 400])
    def test_a_smooth_start_belongs_to_the_motion(self, power, held):
        t = 5e-5 * np.arange(20000)
        u = 75.0 + 60.0 * np.sin(2.0 * np.pi * 5.0 * t) * np.minimum(1.0, t / 0.1) ** (power - 1)
        u = np.concatenate([np.full(held, 75.0), u])
        y = 0.1 * u + 0.003 * np.random.default_rng(1).standard_normal(u.size)
        assert dead_start(Record([u], [y], 5e-5)) == held

    def test_a_record_that_begins_in_motion_has_no_dead_start(self):
        late = slice(30, None)
        assert dead_start(Record([U[late] + 2.0, 0 * U[late] + 0.5], [X[late] - 50.0], 5e-3)) == 0

    @pytest.mark.parametrize("ringing", [(), (0,), (1,), (0, 1)])
    def test_one_output_that_moves_while_the_voltage_is_held_is_enough(self, ringing):
        """A record that begins while any of its axes still rings or creeps does not begin at rest."""
        u, x = np.concatenate([np.zeros(80), U]), np.concatenate([np.zeros(80), X])
        decay = 20.0 * np.exp(-np.arange(x.size) / 25.0)
        record = Record([u], [x + decay * (o in ringing) for o in range(2)], 5e-3)
        assert moves_while_held(record) == bool(ringing)
        assert dead_start(record) == (0 if ringing else 80)

    @pytest.mark.parametrize("gain", [1.0, -1.0])
    def test_swapped_columns_are_told_by_the_direction_of_the_loop(self, gain):
        right = Record([U], [gain * X], 5e-3, ("ux",), ("x",))
        assert leads([right]) == ()
        refuse_swapped([right])
        if gain > 0:
            swapped = Record([X], [U], 5e-3, ("x",), ("ux",), "loop.csv")
            assert leads([swapped]) == ((0, 0),)
            text = message(refuse_swapped, [swapped])
            assert text.startswith("loop.csv: 1 mistake\n  column ux, rows 1 to 400  leads x by ")
            assert "swapped?" in text

    def test_lag_is_the_phase_of_a_sine(self):
        n = np.arange(4000)
        for degrees in (-20.0, 0.0, 35.0):
            y = np.sin(2.0 * np.pi * n / 200 - np.radians(degrees))
            lag = lag_rad([Record([np.sin(2.0 * np.pi * n / 200)], [y], 5e-3)])
            assert np.degrees(lag[0, 0]) == pytest.approx(degrees, abs=1e-6)

    def test_a_lag_above_resonance_is_not_taken_for_a_lead(self):
        n = np.arange(4000)
        for degrees in (100.0, 150.0, 178.0, 290.0):
            y = np.sin(2.0 * np.pi * n / 200 - np.radians(degrees))
            assert leads([Record([np.sin(2.0 * np.pi * n / 200)], [y], 5e-3)]) == ()
