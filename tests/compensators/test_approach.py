"""Holds reached from one side: backlash that the model does not know is then the same in each."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
import theory

from hammerstein import HammersteinModel
from hammerstein.commands.cli import main
from hammerstein.compensators.added_motion import _beginning, approached
from hammerstein.dynamics.models import StaticDynamics
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii

STEP_S, GAIN, HALF_BACKLASH_UM = 1e-3, 2.0, 0.3
TARGETS_UM = [0.0, 3.0, 8.0, 5.0, 3.0, 6.0, 5.0, 0.0, 3.0]
HOLD, MOVE = 200, 50


def _stage(folder):
    """A stage that its model takes for a mere gain."""
    plant = PrandtlIshlinskii([[Pair([0.0], [GAIN])]])
    model = HammersteinModel("stage", plant, StaticDynamics(n_outputs=1), 10.0, ("u",), ("y",))
    model.save(folder / "stage.json")
    return folder / "stage.json"


def _targets():
    """Moves from target to target in 50 ms and holds of 200 ms, and the last sample of each hold."""
    parts = [np.full(HOLD, TARGETS_UM[0])]
    for before, target in pairwise(TARGETS_UM):
        parts += [np.linspace(before, target, MOVE + 1)[1:-1], np.full(HOLD, target)]
    return np.concatenate(parts), HOLD - 1 + (HOLD + MOVE - 1) * np.arange(len(TARGETS_UM))


def _reached(drive_v):
    """Where a stage with backlash behind its gain comes to rest."""
    return theory.play(GAIN * drive_v, HALF_BACKLASH_UM)


@pytest.mark.parametrize("side", [None, -1.0, 1.0])
def test_unknown_backlash_is_the_same_in_every_hold(tmp_path, side):
    path, ends = _targets()
    time_s = STEP_S * np.arange(len(path))
    pd.DataFrame({"time_s": time_s, "y_um": path}).to_csv(tmp_path / "path.csv", index=False)
    out = tmp_path / "drive.csv"
    asked = ["compensate", _stage(tmp_path), tmp_path / "path.csv", "--law", "exact_inverse", "--out", out]
    with pytest.raises(SystemExit) as caught:
        main([*map(str, asked), *([] if side is None else ["--approach-side", f"{side}"])])
    assert not caught.value.code
    table = pd.read_csv(out, comment="#")
    drive = np.interp(time_s, table["time_s"], table["drive_u_v"])
    off = (_reached(drive) - path)[ends]
    if side is None:
        assert np.ptp(off) == pytest.approx(2.0 * HALF_BACKLASH_UM, rel=0.01)
    else:
        np.testing.assert_allclose(off, np.sign(side) * HALF_BACKLASH_UM, atol=2e-3)
        assert "Holds reached from one side: y 9 from" in out.read_text()


def test_holds_that_the_path_reaches_from_the_right_side_have_no_detour():
    rising = np.concatenate([np.full(200, 0.0), np.linspace(0.0, 4.0, 50), np.full(200, 4.0)])[None]
    found = approached(rising, [-1.0], STEP_S)
    assert (found.detours, found.right, found.short) == ((1,), (1,), (0,))  # where it came from is not known
    np.testing.assert_array_equal(found.path_um[0, 200:], rising[0, 200:])
    assert approached(rising, [1.0], STEP_S).detours == (2,)


def test_a_small_move_from_the_right_side_takes_up_no_backlash():
    """Down by 4, then up by 0.5: the backlash of 1 is not taken up. Nor may short holds count as reached."""
    path = np.concatenate(
        [np.full(200, 4.0), np.linspace(4, 0, 50), np.linspace(0, 0.5, 50), np.full(200, 0.5)]
    )
    assert approached(path[None], [-1.0], STEP_S).detours == (2,)
    assert approached(path[None], [-0.4], STEP_S).right == (1,)
    short = np.concatenate([path, np.linspace(0.5, 0.0, 20), np.full(30, 0.0)])
    found = approached(short[None], [-1.0], STEP_S)
    assert found.short == (1,)
    assert "y 2 from below, 2 by a detour, 1 not (shorter than 0.08 s)" in found.statement(["y"])


@pytest.mark.parametrize(
    ("path", "distance", "message"),
    [
        (np.sin(np.arange(500) / 50.0), [-1.0], "no output of the path is constant for 0.08 s"),
        (np.ones(500), [0.0], "needs a distance other than 0"),
        (np.ones(500), [1.0, 2.0], "or one for each of 1"),
    ],
)
def test_what_cannot_be_approached_is_refused(path, distance, message):
    with pytest.raises(InputError, match=message):
        approached(path[None], distance, STEP_S)


def test_an_output_without_backlash_keeps_its_path():
    path = np.stack([np.full(500, 2.0), np.full(500, 3.0)])
    found = approached(path, [-1.0, 0.0], STEP_S)
    np.testing.assert_array_equal(found.path_um[1], path[1])
    assert found.path_um[0].min() == pytest.approx(1.0, abs=1e-3)
    assert found.statement(["x", "y"]) == "Holds reached from one side: x 1 from below, 1 by a detour."


@pytest.mark.parametrize(("third", "smooth"), [(0.2, True), (-0.4, True), (0.7, False), (-1.5, False)])
def test_a_corner_or_noise_at_the_beginning_is_no_acceleration(third, smooth):
    """A cubic through the first four samples has it; after a corner, the first step is the velocity."""
    k = np.arange(6.0)
    path = np.cumsum([0.0, 3.0, 4.0, 5.0 + third, 6.0, 6.0])[None]  # second difference 1, then 1 + third
    velocity, acceleration = _beginning(path, 1.0)
    cubic = np.polynomial.polynomial.polyfit(k[:4], path[0, :4], 3)
    assert velocity[0] == pytest.approx(cubic[1] if smooth else 3.0)
    assert acceleration[0] == pytest.approx(2.0 * cubic[2] if smooth else 0.0, abs=1e-12)
