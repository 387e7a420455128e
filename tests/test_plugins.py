"""What another package can add without a change in this one."""

from typing import Literal

import numpy as np
import pytest

import hammerstein
from hammerstein import plugins
from hammerstein.signals import SIGNALS, OnAxes, OneFrequency


class Sawtooth(OnAxes):
    """Rises for most of each cycle, then flies back."""

    kind: Literal["sawtooth"] = "sawtooth"
    flyback: float = 0.1

    def _wave(self, cycles):
        phase, top = cycles % 1.0, 1.0 - self.flyback
        return np.where(phase < top, 2.0 * phase / top - 1.0, 1.0 - 2.0 * (phase - top) / self.flyback)


@pytest.fixture
def sawtooth():
    yield hammerstein.register(Sawtooth)
    SIGNALS.remove(Sawtooth)


SCAN = {
    "question": "How well does it scan?",
    "actuator": "duo_bimorph_static",
    "reference": {"kind": "sawtooth", "amplitude_um": 20.0, "frequency_hz": 10.0, "flyback": 0.2},
    "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
    "measure": {"settle_cycles": 1, "measured_cycles": 1},
}


def test_a_signal_of_another_package_is_named_by_a_scenario_in_either_unit(sawtooth):
    report = hammerstein.run(SCAN)
    direct = [row for row in report.rows if row.excited_axis == row.measured_axis]
    assert direct[0].amplitude_um == 20.0
    assert max(row.max_true_um for row in direct) < 0.01  # half a step of the converter, times the slope
    drive = {"kind": "sawtooth", "amplitude_v": 5.0, "frequency_hz": 10.0}
    loop = {key: SCAN[key] for key in ("question", "actuator", "measure")} | {"drive": drive}
    assert hammerstein.simulate(loop).drive_v.max() == pytest.approx(5.0, abs=2e-3)


def test_its_mistakes_are_told_like_those_of_the_package(sawtooth):
    wrong = {**SCAN, "reference": SCAN["reference"] | {"flybak": 0.2}}
    with pytest.raises(hammerstein.InputError, match=r"reference.flybak +unknown key; did you mean flyback"):
        hammerstein.run(wrong)


def test_a_kind_that_nobody_has_added_is_refused():
    with pytest.raises(hammerstein.InputError, match="'sawtooth' is not one of"):
        hammerstein.run(SCAN)


def test_a_name_belongs_to_one_kind(sawtooth):
    class Other(OnAxes):
        kind: Literal["sawtooth"] = "sawtooth"

        def _wave(self, cycles):
            return cycles

    with pytest.raises(hammerstein.InputError, match="is taken"):
        hammerstein.register(Other)


def test_a_kind_needs_a_name_and_a_family():
    class Nameless(OneFrequency):
        def _values(self, time_s, n_axes):
            return np.zeros((n_axes, len(time_s)))

    with pytest.raises(hammerstein.InputError, match="names no kind"):
        hammerstein.register(Nameless)
    with pytest.raises(hammerstein.InputError, match="plugs in"):
        hammerstein.register(int)


def test_entry_points_are_found(monkeypatch):
    class Entry:
        def load(self):
            return Sawtooth

    monkeypatch.setattr(plugins, "entry_points", lambda group: [Entry()] if group == plugins.GROUP else [])
    plugins.load_plugins.cache_clear()
    try:
        assert hammerstein.run(SCAN).rows
    finally:
        SIGNALS.remove(Sawtooth)
        plugins.load_plugins.cache_clear()
