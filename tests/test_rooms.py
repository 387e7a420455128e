"""How many rooms a scenario passes on its way to a report."""

import sys
from pathlib import Path

import hammerstein
from hammerstein.reporting.folder import write_report

PACKAGE = Path(hammerstein.__file__).parent
SCENARIO = {
    "question": "How round is a circle?",
    "actuator": "duo_bimorph_static",
    "reference": {"kind": "circle", "radius_um": 20.0, "frequency_hz": 50.0},
    "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
}


def test_a_run_to_its_report_enters_nine_rooms(tmp_path):
    def to_a_report(name):
        write_report(hammerstein.run(SCENARIO), tmp_path / name, figures=False)

    entered = set()

    def note(frame, event, argument):
        if event == "call":
            entered.add(frame.f_code.co_filename)

    to_a_report("first")  # what is imported on the way is no step of it
    sys.setprofile(note)
    try:
        to_a_report("second")
    finally:
        sys.setprofile(None)
    files = [Path(name).relative_to(PACKAGE) for name in entered if name.startswith(f"{PACKAGE}/")]
    rooms = {file.parts[0] for file in files if len(file.parts) > 1} - {"templates"}
    assert rooms <= {
        *("scenario", "experiment", "compensators", "hysteresis", "dynamics", "metrics", "reporting"),
        *("runtime", "storage"),
    }
