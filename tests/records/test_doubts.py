"""What makes the figures of a report worth little is said in its answer, and on the terminal."""

import json

import pytest

from hammerstein import HammersteinModel, Scenario, run
from hammerstein.blocks.voltages import Verdict, Voltages
from hammerstein.commands.cli import main
from hammerstein.reporting.summary import doubts, sentences

GUESS = "The voltages exceed the records of the simulated actuator"


def answer(report):
    """What its sentences say, in one line."""
    return " ".join(one.words for one in sentences(report))


def stage(place, most_v=5.0, **verdict):
    """File of a model that was recorded from -most_v to most_v."""
    model = HammersteinModel.load("duo_bimorph_static")
    recorded = Voltages.symmetric(most_v, 2)
    given = Verdict(flagged=False, held_out=True) if not verdict else Verdict.model_validate(verdict)
    content = json.loads(model.to_json()) | {
        "voltages": json.loads(recorded.model_dump_json()),
        "verdict": json.loads(given.model_dump_json()),
    }
    place.write_text(json.dumps(content))
    return str(place)


def sine(actuator, model, amplitude_um=10.0):
    return Scenario.model_validate(
        {
            "question": "How far off?",
            "actuator": actuator,
            "reference": {"kind": "sine", "amplitude_um": amplitude_um, "frequency_hz": 50.0, "axis": 1},
            "compensators": [{"label": "exact", "law": "exact_inverse", "model": model}],
        }
    )


@pytest.mark.parametrize(("amplitude_um", "said"), [(30.0, True), (2.0, False)])
def test_an_actuator_that_leaves_its_own_records_is_a_guess(tmp_path, amplitude_um, said):
    file = stage(tmp_path / "stage.json")
    report = run(sine(file, "duo_bimorph_static", amplitude_um))
    assert (GUESS in answer(report)) == said
    told = [text for text in report.statements if text.startswith("the simulated actuator: the drive goes")]
    assert len(told) == said
    for text in told:
        assert "V on x, but it was recorded from -5 to 5 V" in text
        assert "instruments.drive.range_v" in text


def test_a_packaged_actuator_was_never_recorded():
    assert GUESS not in answer(run(sine("duo_bimorph_static", "duo_bimorph_static", 30.0)))


def test_flags_of_a_model_and_of_what_is_simulated_are_told(tmp_path, capsys):
    bad = stage(tmp_path / "bad.json", 100.0, flagged=True, statements=["the record drifts"], held_out=True)
    good = stage(tmp_path / "good.json", 100.0)
    assert doubts(run(sine(good, good))) == []
    report = run(sine(good, bad))
    assert doubts(report) == ["exact: flagged by its fit report: the record drifts."]
    assert "Flagged by its fit report: exact." in answer(report)
    both = answer(run(sine(bad, bad)))
    assert "Flagged by their fit report: exact, the simulated actuator." in both
    scenario = tmp_path / "sine.toml"
    scenario.write_text(
        f"""
question = "How far off?"
actuator = {bad!r}
reference = {{ kind = "sine", amplitude_um = 10.0, frequency_hz = 50.0, axis = 1 }}
compensators = [{{ label = "exact", law = "exact_inverse", model = {good!r} }}]
"""
    )
    with pytest.raises(SystemExit) as ended:
        main(["run", str(scenario), "--out", str(tmp_path / "out"), "--no-figures"])
    assert not ended.value.code
    said = capsys.readouterr().err
    assert "sine: the simulated actuator: flagged by its fit report: the record drifts." in said


@pytest.mark.parametrize("command", ["compensate", "export"])
def test_warnings_of_a_model_are_printed_even_where_little_is_wanted(tmp_path, capsys, command):
    bad = stage(tmp_path / "bad.json", 10.0, flagged=True, statements=["the record drifts"], held_out=False)
    path = tmp_path / "path.csv"
    path.write_text("time_s,x_um,y_um\n" + "".join(f"{k * 50e-6},{0.01 * k},0\n" for k in range(100)))
    given = [str(path)] if command == "compensate" else []
    out = ["--out", str(tmp_path / "out"), "--law", "exact_inverse", "--accept-flagged"]
    with pytest.raises(SystemExit) as ended:
        main(["-q", command, bad, *given, *out])
    assert not ended.value.code
    said = capsys.readouterr()
    assert said.out == ""
    assert "FLAGGED by its fit report: the record drifts" in said.err
    assert ("no validation record" in said.err) == (command == "compensate")


def test_what_is_designed_from_the_actuator_itself_is_said_with_the_error_of_its_fit(tmp_path):
    file = stage(tmp_path / "stage.json", 100.0, flagged=False, held_out=True, nrmse_percent=[0.5, 2.0])
    off = "(0.5 % of the range of x and 2 % of that of y on validation records, from its fit report)."
    report = run(sine(file, file))
    assert "has a perfect model, unlike a real one" in answer(report)
    assert any(off in text for text in report.statements)
    assert "has a perfect model" not in answer(run(sine("duo_bimorph", "duo_bimorph_static")))
