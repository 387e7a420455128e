"""Each fault of a record is named as what it is, with rows, and none of the others is suspected."""

import re
from dataclasses import replace

import made_up
import numpy as np
import pytest
import record_faults as made
from record_cases import plain
from record_faults import SHAPES, STEP_S, copied, measured

from hammerstein.errors import HammersteinError
from hammerstein.identification.identify import identify
from hammerstein.identification.residual_analysis import faults_left
from hammerstein.records.faults import faults
from hammerstein.records.record import Record

WORDS = {
    "outliers": "outliers",
    "drift": "drifts by",
    "clipped command": "is clipped on its way",
    "clipped reading": "is clipped by its recorder",
    "saturation": "saturates",
    "swapped": "columns swapped",
    "butterfly": "no rising loop",
    "inseparable": "never move independently",
    "never turns": "never turns|no voltage turns",
    "never driven": "never driven",
    "noise": "readings are noise",
    "lag": "phase lag looks like hysteresis",
    "clipped sensor": "stays at",
    "missed": "the error of",
}
"""What is said of each fault, and of no other."""

PERIODIC = ("sines", "one-sided", "starts in motion")
SLOW = ("falling triangles", "falling triangles both ways", *PERIODIC)
ALL = tuple(SHAPES)
LOST = r"rows 501 to 506 \(-9999\), row 2001 \(-9999\): 7 of"


def weekly(*case):
    """Another shape of record on which a fault is found in the same way as on those that always run."""
    return pytest.param(*case, marks=pytest.mark.long)


QUICK = {
    made.one_sample: ("prbs", "holds"),
    made.lost_cells: ("one-sided",),
    made.lost_rows: ("decaying sines", "biased"),
    made.drive_spike: ("multisine", "random levels"),
    made.drift: ("falling triangles",),
    made.thermal_drift: ("falling triangles both ways",),
    made.clipped_command: ("starts in motion",),
    made.clipped_reading: ("sines",),
    made.saturation: ("sines",),
    made.swapped: ("falling triangles",),
    made.half_swapped: ("falling triangles",),
}
"""Shapes of record on which each fault is always looked for: every fault, and every shape."""

FAULTS = [
    *((made.one_sample, "outliers", r"row 1234 \(200\): 1 of", shape) for shape in ALL),
    *((made.lost_cells, "outliers", LOST, shape) for shape in PERIODIC),
    *(weekly(made.lost_cells, "outliers", LOST, shape) for shape in ALL if shape not in PERIODIC),
    *(
        (made.lost_rows, "outliers", r"rows 2101 to 2103 \(-9999\): 3 of", shape)
        for shape in ALL
        if shape not in ("prbs", "random levels")
    ),
    *((made.drive_spike, "outliers", r"u_x: row 2222 \(", shape) for shape in ALL),
    *(
        (made.drift, "drift", r"x of r0.csv drifts by [45]\.\d* um from row \d+ to row \d{4}", shape)
        for shape in SLOW
    ),
    *((made.thermal_drift, "drift", r"y of r0.csv drifts by [234]\.\d* um", shape) for shape in SLOW),
    *(
        (made.clipped_command, "clipped command", r"the command exceeds .* V \(rows \d+ to \d+", shape)
        for shape in SLOW
    ),
    *(
        (made.clipped_reading, "clipped reading", r"while it is constant \(rows \d+ to \d+", shape)
        for shape in PERIODIC
    ),
    *((made.saturation, "saturation", r"row \d+|steepest slope", shape) for shape in SLOW),
    *((made.swapped, "swapped", r"column x, rows 1 to .*column y, rows 1 to", shape) for shape in SLOW),
    (made.half_swapped, "swapped", r"column y, rows 1 to", SLOW[0]),
    *(weekly(made.half_swapped, "swapped", r"column y, rows 1 to", shape) for shape in SLOW[1:]),
]


def diagnosis(us, ys):
    """Everything that is said of records."""
    try:
        records = [
            Record(u, y, STEP_S, ("u_x", "u_y"), ("x", "y"), f"r{k}.csv")
            for k, (u, y) in enumerate(zip(us, ys, strict=True))
        ]
        _, fit = identify(records, plain(operators=10, delay_samples=0))
    except HammersteinError as error:
        return str(error)
    return "\n".join([fit.verdict, *fit.flags, *fit.not_identifiable, *fit.notes])


def suspicions(said):
    return {fault for fault, words in WORDS.items() if re.search(words, said)}


def selected(case):
    """A case as it is, or one that runs with ``--full``."""
    if type(case) is not tuple or case[-1] in QUICK[case[0]]:
        return case
    return pytest.param(*case, marks=pytest.mark.full)


@pytest.mark.parametrize(
    "noise",
    [
        pytest.param(1e-4, marks=pytest.mark.full),
        pytest.param(1e-3, marks=pytest.mark.long),
        1e-2,
    ],
)
@pytest.mark.parametrize(
    "shape", [pytest.param(shape, marks=pytest.mark.full) if k % 3 else shape for k, shape in enumerate(ALL)]
)
def test_a_clean_record_raises_no_suspicion(shape, noise):
    said = diagnosis(*copied(measured(shape, noise, seed=int(1e4 * noise))))
    assert suspicions(said) == set(), said


@pytest.mark.parametrize(
    ("fault", "name", "rows", "shape"), [*map(selected, FAULTS)], ids=lambda v: getattr(v, "__name__", None)
)
def test_a_fault_is_named_with_its_rows_and_none_of_the_others(fault, name, rows, shape):
    us, ys = copied(measured(shape))
    fault(us, ys)
    said = diagnosis(us, ys)
    assert suspicions(said) == {name}, said
    assert re.search(rows, said, re.DOTALL), said


@pytest.mark.parametrize("seed", [37, 44])
def test_axes_of_very_different_gains_are_judged_each_by_its_own_output(seed):
    """Inputs that fall together: the output with the larger gain belongs to one input."""
    weights = [[[0.1, 0.02, 0.02], [0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [1.0, 0.2, 0.2]]]
    thresholds = np.tile([0.0, 5.0, 20.0], (2, 1))
    stage = made_up.MadeUp(thresholds, np.array(weights), 0.0, 100.0, 2e3, (60.0, 40.0), (0.02, 0.2))
    t, rng = np.arange(4000) / 2e3, np.random.default_rng(seed)
    lines = np.arange(4, 80)
    multisines = [
        (4 / (1 + lines / 6)) @ np.cos(np.pi * np.outer(lines, t) + rng.uniform(0, 6.3, lines.size)[:, None])
        for _ in range(2)
    ]
    u = np.clip(25.0 + 30.0 * np.clip(1 - t, 0, 1) + multisines, 0, 100)
    found = faults(Record(u, stage.position_um(u), 5e-4))
    assert not [fault for fault in found if "on its way" in fault.text]


@pytest.mark.parametrize(("coupled", "told"), [(0.015, False), (0.5, True)])
def test_a_bend_is_told_where_it_is_much_of_the_largest_range(coupled, told):
    u = np.sin(2.0 * np.pi * np.arange(4000) / 1000) * np.linspace(1.0, 0.3, 4000)
    record = Record([u], [100.0 * u, 100.0 * coupled * np.tanh(2.0 * u)], STEP_S, ("u_x",), ("x", "y"))
    assert [fault.outputs for fault in faults(record) if "saturates" in fault.text] == told * [("y",)]


def creeping_record():
    stage = made_up.stage(
        3, resonances_hz=None, plays=9, rate_hz=2e3, noise_um=2e-3, creep=((0.07, 0.08),), loop=0.1
    )
    one = {"thresholds_v": stage.thresholds_v[:1], "weights_um_per_v": stage.weights_um_per_v[:1, :1]}
    stage = replace(stage, **one)
    u = made_up.triangles(stage, 0, cycles=4, hz=4.0)
    return Record(u, stage.record(u, np.random.default_rng(0)), 5e-4, source="short.csv")


def test_creep_that_the_model_has_is_not_told_as_drift():
    """A short record of a creeping axis has a trend, whatever plays and delayed voltages explain."""
    record, settings = creeping_record(), plain(operators=20, delay_samples=0)
    _, without = identify([record], settings)
    assert suspicions("\n".join(without.notes)) == {"drift"}
    _, fit = identify([record], settings.changed(dynamics="lag", creep_modes=1))
    assert fit.axes[0].axis.creep[0].gain == pytest.approx(0.07, rel=0.2)
    assert suspicions("\n".join(fit.flags)) == set()
    model = fit.candidates["hammerstein"]
    (mode,) = model.dynamics.axes[0].creep
    for part, words in ((0.3, True), (0.0, False)):  # a model with too little creep may lack something else
        modes = [mode.model_copy(update={"gain": part * mode.gain})] if part else []
        axis = model.dynamics.axes[0].model_copy(update={"creep": tuple(modes)})
        less = replace(model, dynamics=model.dynamics.model_copy(update={"axes": (axis,)}))
        (left,) = faults_left(less, fit.records, fit.starts)
        assert suspicions(left.text) == {"drift"}
        assert ("hammerstein compare tries the others" in left.text) == words
