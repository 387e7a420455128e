"""Whether waiting longer helps, and why not."""

from dataclasses import replace

import numpy as np
import pytest

from hammerstein.experiment.run import run
from hammerstein.experiment.set_up import set_up
from hammerstein.model import HammersteinModel
from hammerstein.reporting.run_page import gathered
from hammerstein.scenario import Scenario

SINE = {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 50.0, "axis": 1}
UNEVEN_HZ = 15.1
"""151 cycles before their samples, 50 us apart, fall where they fell: it oscillates, and repeats nowhere."""
PAPER = {"label": "paper", "law": "inverse_multiplicative", "run_anyway": True}


def _told(**content):
    base = {"question": "?", "actuator": "duo_bimorph", "reference": SINE}
    return [text for text in run(base | content).statements if "settled" in text]


def test_a_resonance_that_still_rings_settles_when_one_waits():
    law = {"label": "none", "law": "none", "model": "duo_bimorph"}
    fast = {"reference": SINE | {"frequency_hz": 200.0}}
    measure = {"settle_cycles": 1, "settle_s": 0.0}
    (text,) = _told(compensators=[law], measure=measure, **fast)
    cycles = int(text.split("measure.settle_cycles = ")[1].rstrip("."))
    assert cycles in (2, 20)
    assert not _told(compensators=[law], measure=measure | {"settle_cycles": cycles}, **fast)


def test_a_law_that_does_not_converge_never_settles():
    wild = PAPER | {"identification": {"frequency_hz": 200}}
    slow = SINE | {"frequency_hz": UNEVEN_HZ}
    (text,) = _told(reference=slow, compensators=[wild])
    assert (
        "it does not settle in 20 times as many cycles either: the iteration of the law does not converge"
        in text
    )


@pytest.mark.parametrize("creeping", [2, 1])
def test_creep_outlasts_twenty_times_the_cycles(tmp_path, creeping):
    """Of both axes, or of the first alone, which is the one that is driven."""
    model = HammersteinModel.load("duo_bimorph_creep")
    still = [axis.model_copy(update={"creep": ()}) for axis in model.dynamics.axes[creeping:]]
    dynamics = model.dynamics.model_copy(update={"axes": (*model.dynamics.axes[:creeping], *still)})
    replace(model, dynamics=dynamics).save(tmp_path / "creeps.json")
    law = {"label": "none", "law": "none", "model": "duo_bimorph"}
    offset = SINE | {"offset_um": 20.0}
    measure = {"settle_cycles": 1, "settle_s": 0.0, "measured_cycles": 60}
    actuator = str(tmp_path / "creeps.json")
    (text,) = _told(actuator=actuator, reference=offset, compensators=[law], measure=measure)
    assert "the actuator creeps, with time constants up to 300 s" in text


def test_a_run_that_models_share_is_called_by_its_actuator():
    """It was "3 operators at 50 Hz": the first of seven models, which all predict the same run."""
    models = [{"label": f"model {k}", "model": "duo_bimorph_static"} for k in (1, 2)]
    drive = {"kind": "sine", "amplitude_v": 8.0, "frequency_hz": 200.0, "axis": 1}
    measure = {"settle_cycles": 0, "settle_s": 0.0}
    said = run(
        {"question": "?", "actuator": "duo_bimorph", "drive": drive, "models": models, "measure": measure}
    )
    assert [text.partition(" at ")[0] for text in said.statements if "settled" in text] == ["duo_bimorph"]


@pytest.mark.parametrize("law", [{"filter_hz": 200.0}, {"preview_s": 0.002}])
def test_a_path_goes_on_for_a_law_that_looks_ahead(law):
    """A run does not end with a stop that the law prepares: its voltages are those of a longer run."""
    law = {"label": "ahead", "law": "hammerstein_inverse", "model": "duo_bimorph"} | law
    triangle = {
        "kind": "triangle",
        "amplitude_um": 20.0,
        "frequency_hz": 100.0,
        "axis": 1,
        "smooth_start_s": 0.02,
    }
    asked = {"question": "?", "actuator": "duo_bimorph", "reference": triangle, "compensators": [law]}
    drives = []
    for cycles in (2, 4):
        here = set_up(Scenario.model_validate(asked | {"measure": {"measured_cycles": cycles}}))
        (case,) = here.cases()
        drives.append(here.simulate(case).drive_v)
    assert drives[1].shape[1] == drives[0].shape[1] + 400
    assert np.array_equal(drives[0], drives[1][:, : drives[0].shape[1]])
    assert not _told(reference=triangle, compensators=[law])


@pytest.mark.parametrize("cycles", [2, 8])
def test_what_has_settled_says_nothing(cycles):
    law = {"label": "exact", "law": "exact_inverse", "model": "duo_bimorph"}
    assert not _told(compensators=[law], measure={"settle_cycles": cycles})


@pytest.mark.parametrize(("cycles", "settled"), [(3, False), (9, True)])
def test_a_percent_between_cycles_is_not_settled(cycles, settled):
    """The resonance of 280 Hz and damping 0.12 rings by exp(-211 t): 4 % after 3 cycles, 0.007 % after 9."""
    law = {"label": "none", "law": "none", "model": "duo_bimorph"}
    measure = {"settle_cycles": cycles, "settle_s": 0.0}
    assert (
        bool(_told(compensators=[law], measure=measure, reference=SINE | {"frequency_hz": 200.0})) != settled
    )


def test_samples_that_fall_elsewhere_in_each_cycle_are_no_lack_of_settling():
    """At 15 Hz and 50 us 3 cycles are 4000 samples: an oscillation repeats so, while neighbours differ."""
    wild = PAPER | {"identification": {"frequency_hz": 200}}
    assert not _told(
        reference=SINE | {"frequency_hz": 15.0}, compensators=[wild], measure={"settle_cycles": 4}
    )


def test_what_is_said_of_two_runs_at_once_names_no_owner():
    ways = ({"frequency_hz": 200}, {"frequency_hz": 210})
    laws = [PAPER | {"label": f"paper {k}", "identification": own} for k, own in enumerate(ways)]
    reference = SINE | {"frequency_hz": UNEVEN_HZ}
    report = run({"question": "?", "actuator": "duo_bimorph", "reference": reference, "compensators": laws})
    shared = [said for said in gathered(report.statements) if said.startswith("paper 0;")]
    assert [said.count("; paper 1, all at") for said in shared] == [1]
    assert " its " not in shared[0]


def test_a_file_does_not_go_on_beyond_its_last_row(tmp_path):
    """A law that saw it stand there would prepare a corner: the voltages are those of the path alone."""
    time_s = 1e-4 * np.arange(400)
    rows = np.stack([time_s, 5.0 * (1.0 - np.cos(150.0 * time_s)), 0.0 * time_s], axis=1)
    np.savetxt(tmp_path / "path.csv", rows, delimiter=",", header="time_s,x [um],y [um]", comments="")
    law = {"label": "ahead", "law": "hammerstein_inverse", "model": "duo_bimorph", "filter_hz": 500.0}
    asked = {"question": "?", "actuator": "duo_bimorph", "compensators": [law]}
    asked["reference"] = {"kind": "file", "path": str(tmp_path / "path.csv")}
    here = set_up(Scenario.model_validate(asked))
    (case,) = here.cases()
    found = here.simulate(case)
    assert np.array_equal(found.requested_v, here.laws["ahead"].drive_for(found.reference_um))
