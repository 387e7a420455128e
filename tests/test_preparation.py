"""What is found out about a record before a fit: delay, dead start, swapped columns."""

from __future__ import annotations

import numpy as np
import pytest
from record_cases import THRESHOLDS, N, U, X, message, plays

from hammerstein.records.preparation import estimate_delay, lag_rad, leads, prepare, refuse_swapped
from hammerstein.records.record import Record


class TestPreparation:
    def test_offset_and_dead_start_under_noise(self):
        rng = np.random.default_rng(2)
        u = np.concatenate([np.zeros(80), U]) + 3.0
        x = np.concatenate([np.zeros(80), X]) - 95.0
        record = Record([u], [x + 0.04 * rng.standard_normal(x.size)], 5e-3)
        prepared = prepare(record)
        assert prepared.at_rest
        assert prepared.dead_start_samples == 80
        assert prepared.offset_v.tolist() == [3.0]
        assert prepared.offset_um[0] == pytest.approx(-95.0, abs=0.015)
        np.testing.assert_allclose(prepared.record.u_v[0], U, atol=1e-14)
        assert prepared.record.rows[0] == 81

    def test_dead_start_of_a_noisy_voltage(self):
        rng = np.random.default_rng(3)
        u = np.concatenate([np.zeros(80), U]) + 0.005 * rng.standard_normal(N + 80)
        assert prepare(Record([u], [u], 5e-3)).dead_start_samples == pytest.approx(80, abs=3)

    def test_a_delay_is_left_alone_unless_it_is_asked_for(self):
        late = Record([U], [np.concatenate([np.zeros(3), X[:-3]])], 5e-3)
        assert prepare(late).delay_samples == 0
        assert prepare(late, 5).delay_samples > 0

    def test_without_dead_start_offsets_are_the_middle(self):
        late = slice(30, None)
        prepared = prepare(Record([U[late] + 2.0, 0 * U[late] + 0.5], [X[late] - 50.0], 5e-3))
        assert not prepared.at_rest
        assert prepared.offset_v == pytest.approx([2.0, 0.5])
        assert prepared.offset_um == pytest.approx([-50.0], abs=1e-9)
        assert prepared.dead_start_samples == 0

    @pytest.mark.parametrize("delay", [0, 1, 4])
    @pytest.mark.parametrize("noise", [0.0, 0.04])
    def test_delay_is_told_from_hysteresis(self, delay, noise):
        """The hysteresis alone lags by eight degrees, more than four samples of 200 a period."""
        rng = np.random.default_rng(4)
        u = np.concatenate([U, 0.7 * U, 0.4 * U])
        x = np.array([4.0, 0.5, 0.8, 1.2]) @ plays(u, THRESHOLDS)
        late = np.concatenate([np.zeros(delay), x[: len(x) - delay]])
        record = Record([u], [late + noise * rng.standard_normal(x.size)], 5e-3)
        assert np.degrees(lag_rad([record])[0, 0]) > 4.0 + 1.8 * delay
        assert estimate_delay(record, 6) == delay
        prepared = prepare(record, max_delay_samples=6)
        assert prepared.delay_samples == delay
        np.testing.assert_allclose(
            prepared.record.y_um[0], x[: len(x) - delay] - prepared.offset_um, atol=5 * noise + 1e-9
        )

    def test_delay_needs_samples(self):
        assert "too few" in message(estimate_delay, Record([U], [X], 5e-3), 100)

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
