"""Many values of any numeric key: lists, zips, samples; rows as they come."""

import errno
import itertools
import os
import re
import signal
import subprocess
import sys
import tracemalloc

import numpy as np
import pandas as pd
import pytest
from scipy.stats import qmc

from hammerstein.commands import terminal
from hammerstein.commands.cli import main
from hammerstein.errors import InputError
from hammerstein.experiment import study
from hammerstein.experiment.plan import plan_of
from hammerstein.experiment.run import run, simulate
from hammerstein.scenario import Scenario
from hammerstein.scenario.variation import Study

SCENARIO = {
    "question": "?",
    "actuator": "duo_bimorph",
    "reference": {"kind": "sine", "amplitude_um": 10.0, "frequency_hz": 200.0, "axis": 1},
    "compensators": [
        {"label": "paper", "law": "inverse_multiplicative", "model": "duo_bimorph", "iterations": 2}
    ],
}
NOISE, SIZE, PASSES = "instruments.sensor.noise_um", "reference.amplitude_um", "compensators[1].iterations"


def found(values, **more):
    scenario = Scenario.model_validate(SCENARIO | {"study": {"values": values} | more})
    return list(study.sampled(scenario, "s"))


def test_every_combination_or_one_after_the_other():
    values = {SIZE: [5.0, 10.0], NOISE: [0.0, 0.1, 0.2]}
    told = [tuple(one.point.values()) for one in found(values)]
    assert told == list(itertools.product(*values.values()))
    zipped = [tuple(one.point.values()) for one in found({SIZE: [5.0, 10.0], NOISE: [0.0, 0.1]}, how="zip")]
    assert zipped == [(5.0, 0.0), (10.0, 0.1)]


def test_a_run_of_a_study_is_the_run_with_that_value():
    (one,) = found({SIZE: [7.0], NOISE: [0.25], PASSES: [3]})
    scenario = SCENARIO | {
        "reference": SCENARIO["reference"] | {"amplitude_um": 7.0},
        "instruments": {"sensor": {"noise_um": 0.25}},
        "compensators": [SCENARIO["compensators"][0] | {"iterations": 3}],
    }
    assert one.rows == run(scenario).rows


def test_samples_fill_the_box_and_do_not_depend_on_how_many_are_taken():
    values = {SIZE: (5.0, 10.0), NOISE: (0.0, 0.4)}
    for how in ("random", "sobol"):
        few, many = (Study(how=how, samples=n, values=values) for n in (16, 4096))
        points = np.array([list(point.values()) for point in many.points()])
        np.testing.assert_array_equal(points[:16], [list(point.values()) for point in few.points()])
        assert len(points) == many.count() == 4096
        inside = (points - [5.0, 0.0]) / [5.0, 0.4]
        assert inside.min() >= 0.0
        assert inside.max() <= 1.0
        gap = qmc.discrepancy(inside)
        assert gap < (1e-6 if how == "sobol" else 1e-3)


def test_whole_numbers_stay_whole():
    samples = found({PASSES: [1.0, 5.0]}, how="random", samples=6)
    numbers = [one.point[PASSES] for one in samples]
    assert all(isinstance(number, int) for number in numbers)
    assert all(1 <= number <= 5 for number in numbers)
    assert all(one.rows for one in samples)


def test_what_cannot_be_run_is_told_and_the_others_go_on():
    one, far, last = found({SIZE: [5.0, 500.0, 6.0]})
    assert one.rows
    assert last.rows
    assert not far.rows
    assert "reaches" in far.error


@pytest.mark.parametrize(
    "key",
    ["reference.kind", "nothing", "compensators[2].gain", "reference.radus_um", "a[", "",
     "compensators[0].iterations", "compensators[1]"],
)  # fmt: skip
def test_a_key_that_is_no_number_is_refused(key):
    with pytest.raises(InputError, match=r"study\.values") as refused:
        found({key: [1.0]})
    assert key in str(refused.value)


def test_listed_values_that_would_be_rounded_are_refused():
    with pytest.raises(InputError, match=r"iterations +takes whole numbers only, not 2\.5"):
        found({PASSES: [2.0, 2.5]})


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"how": "sobol", "values": {SIZE: (1.0, 2.0)}}, "needs samples"),
        ({"how": "sobol", "samples": 100, "values": {SIZE: (1.0, 2.0)}}, "128 is near"),
        ({"how": "random", "samples": 9, "values": {SIZE: (2.0, 1.0)}}, "two limits"),
        ({"how": "zip", "values": {SIZE: (1.0, 2.0), NOISE: (1.0,)}}, "equally many values"),
        ({"samples": 9, "values": {SIZE: (1.0,)}}, "samples belongs to"),
    ],
)
def test_a_study_that_makes_no_sense_says_why(table, said):
    with pytest.raises(ValueError, match=said):
        Study.model_validate(table)


def test_a_key_that_the_sweep_sets_in_every_run_is_refused():
    """Its values would reach no run, and its column in the table would be untrue."""
    twice = {"sweep": {"amplitude_um": [5.0, 8.0]}, "study": {"values": {SIZE: [1.0, 2.0]}}}
    with pytest.raises(ValueError, match=rf"study\.values: {SIZE} is also swept by sweep\.amplitude_um"):
        Scenario.model_validate(SCENARIO | twice)
    other = {"sweep": {"frequency_hz": [40.0, 50.0]}, "study": {"values": {SIZE: [1.0, 2.0]}}}
    assert Scenario.model_validate(SCENARIO | other).study is not None


def test_points_are_made_as_they_are_wanted():
    many = Study(how="sobol", samples=2**20, values={SIZE: (5.0, 10.0), NOISE: (0.0, 0.4)})
    points = many.points()
    next(points)
    tracemalloc.start()
    try:
        for _ in range(20_000):
            next(points)
        assert tracemalloc.get_traced_memory()[1] < 2e6
    finally:
        tracemalloc.stop()


def test_a_zip_of_the_signals_own_keys():
    scenario = SCENARIO | {
        "sweep": {"combine": "zip", "frequency_hz": [100.0, 200.0], "amplitude_um": [5.0, 10.0]}
    }
    cases = {(row.frequency_hz, row.amplitude_um) for row in run(scenario).rows}
    assert cases == {(100.0, 5.0), (200.0, 10.0)}
    assert abs(simulate(scenario, frequency_hz=200.0).reference_um).max() == pytest.approx(10.0)
    scenario["sweep"] = scenario["sweep"] | {"amplitude_um": [5.0]}
    with pytest.raises(InputError, match="equally many values of each key: frequency_hz 2, amplitude_um 1"):
        run(scenario)


TEXT = """
question = "?"
actuator = "duo_bimorph"
[reference]
kind = "sine"
amplitude_um = 10
frequency_hz = 200
axis = 1
[[compensators]]
label = "none"
law = "none"
model = "duo_bimorph"
[study]
how = "sobol"
samples = 8
values = { "reference.amplitude_um" = [5, 200], "instruments.sensor.noise_um" = [0, 0.1] }
"""


def called(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code or 0


def test_the_table_is_the_same_as_csv_and_parquet_and_after_an_interruption(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pyarrow")
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("HAMMERSTEIN_CACHE_MB", "100")
    (tmp_path / "s.toml").write_text(TEXT)
    files = [tmp_path / "1.csv", tmp_path / "2.parquet", tmp_path / "3.csv"]
    count, real = [], study.rows_alone

    def counted(*arguments):
        count.append(arguments)
        if len(count) == 6:
            raise ZeroDivisionError
        return real(*arguments)

    monkeypatch.setattr(study, "rows_alone", counted)
    assert called("sweep", tmp_path / "s.toml", "--out", files[0]) == 70
    assert not files[0].exists()
    assert called("sweep", tmp_path / "s.toml", "--out", files[0]) == 0
    refused = capsys.readouterr().err
    table = pd.read_csv(files[0])
    failed = table.error.notna().sum()
    assert f"{failed} of 8 runs failed" in refused
    assert len(count) <= 8 + 1 + failed
    assert called("sweep", tmp_path / "s.toml", "--out", files[1]) == 0
    assert called("sweep", tmp_path / "s.toml", "--out", files[2], "--jobs", "2", "--fresh") == 0
    assert files[0].read_bytes() == files[2].read_bytes()
    other = pd.read_parquet(files[1])
    assert list(other) == list(table)
    assert other.rms_um.equals(table.rms_um)
    assert sorted(table["sample"].unique()) == list(range(1, 9))


def test_a_dry_run_says_how_much_it_is(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(TEXT.replace("= 8", "= 65536"))
    assert (
        called("sweep", tmp_path / "s.toml", "--dry-run", "--jobs", "1") == 0
    )  # nothing is written: no --out
    assert re.search("65536 runs of sobol values, about [0-9.]+ [a-z]+, ", capsys.readouterr().err)
    assert called("sweep", tmp_path / "s.toml", "--dry-run", "--jobs", "2") == 0
    assert " with 2 jobs, " in capsys.readouterr().err
    assert called("sweep", tmp_path / "s.toml") == 2
    assert "--out: is missing; give a file for the rows" in capsys.readouterr().err
    (tmp_path / "s.toml").write_text(TEXT.partition("how")[0] + f'values = {{ "{CYCLES}" = [1, 1000000] }}')
    assert called("sweep", tmp_path / "s.toml", "--out", tmp_path / "o.csv", "--dry-run", "--jobs", "1") == 0
    words = r"2 runs of product values, about ([\d.]+) (\w+), ([\d.]+) GB"
    said = re.search(words, capsys.readouterr().err)
    assert said is not None
    seconds = float(said[1]) * {"seconds": 1.0, "minutes": 60.0}[said[2]]
    assert 1e8 * 2e-8 < seconds < 1e8 * 2e-6  # 1e8 samples on whatever processor this is
    assert float(said[3]) > 1e8 * 8 * 8 / 1e9  # at least a number for each of its eight wires
    assert not (tmp_path / "o.csv").exists()


CYCLES = "measure.settle_cycles"


IDENTIFIED = {
    "question": "How far off is a circle?",
    "actuator": "duo_bimorph",
    "reference": {"kind": "circle", "radius_um": 5.0, "frequency_hz": 100.0},
}


def planned(values, **more):
    scenario = Scenario.model_validate(SCENARIO | {"study": {"values": values} | more})
    return study.plan_of_study(scenario, "s")


def of_one(values):
    scenario = Scenario.model_validate(SCENARIO)
    return plan_of(study.varied(scenario, values))


def test_a_study_is_as_long_as_its_runs_together_and_as_large_as_the_largest():
    each = [of_one({CYCLES: cycles, SIZE: size}) for cycles in (0, 10_000) for size in (5.0, 10.0)]
    found = planned({CYCLES: [0, 10_000], SIZE: [5.0, 10.0]})
    assert found.seconds == pytest.approx(sum(one.seconds for one in each))
    assert found.bytes == max(one.bytes for one in each) > 50 * each[0].bytes
    zipped = planned({CYCLES: [0, 10_000], SIZE: [5.0, 10.0]}, how="zip")
    assert zipped.seconds == pytest.approx(each[0].seconds + each[3].seconds)
    impossible = planned({SIZE: [5.0, -1.0]})  # such a run is a row with an error
    assert impossible.seconds == of_one({SIZE: 5.0}).seconds


def test_of_a_large_study_some_runs_tell_how_long_it_is():
    cycles, sizes = list(range(1000)), [float(size) for size in range(1, 51)]
    middle = of_one({CYCLES: 500}).seconds
    for how, values in (
        ("product", {CYCLES: cycles, SIZE: sizes}),
        ("zip", {CYCLES: cycles, SIZE: [sizes[0]] * 1000}),
        ("sobol", {CYCLES: [0, 1000], SIZE: [1.0, 50.0]}),
    ):
        samples = {"samples": 1024} if how == "sobol" else {}
        found = planned(values, how=how, **samples)
        count = Study(how=how, values=values, **samples).count()
        assert found.seconds == pytest.approx(count * middle, rel=0.25)  # of 100 runs: 6 % of the mean
        assert found.bytes >= of_one({CYCLES: 999}).bytes


def test_an_identification_that_runs_share_is_counted_once():
    fitted = {"label": "law", "law": "exact_inverse", "identification": {"method": "hammerstein"}}
    scenario = Scenario.model_validate(IDENTIFIED | {"compensators": [fitted]})

    def seconds(values, **more):
        with_study = scenario.model_copy(update={"study": Study.model_validate({"values": values} | more)})
        return study.plan_of_study(with_study, "s").seconds

    radius, records = "reference.radius_um", "compensators[1].identification.record_s"
    parts = plan_of(study.varied(scenario, {radius: 5.0})).parts
    (identified,) = [part.seconds for part in parts if part.once]
    run = sum(part.seconds for part in parts if part.once is None)
    many = [5.0 + 0.01 * i for i in range(64)]
    assert identified > 10.0 * run
    assert seconds({radius: many}) == pytest.approx(identified + 64.0 * run)
    sobol = seconds({radius: [5.0, 10.0]}, how="sobol", samples=64)
    assert sobol == pytest.approx(identified + 64.0 * run)
    assert seconds({radius: many[:4], "seed": [1, 2]}) == pytest.approx(2.0 * identified + 8.0 * run)
    assert seconds({radius: many[:4], records: [0.1, 0.1]}) == pytest.approx(identified + 8.0 * run)
    assert seconds({radius: many[:4], records: [0.1, 0.2, 0.3]}) > 3.0 * identified
    assert seconds({"instruments.sensor.noise_um": [0.01, 0.02]}) == pytest.approx(2.0 * (identified + run))


def test_a_single_long_run_of_many_is_seen():
    values = {CYCLES: [*([0] * 999), 10_000], SIZE: [10.0] * 1000}
    assert planned(values, how="zip").seconds >= of_one({CYCLES: 10_000}).seconds


def test_what_is_no_scenario_with_a_study_is_refused_before_anything_runs(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "several").mkdir()
    for name in ("several/a", "several/b", "plain"):
        (tmp_path / f"{name}.toml").write_text(TEXT.partition("[study]")[0])
    for arguments, told in (
        (("several", "--out", "o.csv"), "several: is a folder"),
        (("plain.toml", "--out", "o.csv", "--dry-run"), "plain.toml: has no table [study]"),
        (("plain.toml", "--out", "o.csv"), "plain.toml: has no table [study]"),
    ):
        assert called("sweep", *arguments) == 2
        assert told in capsys.readouterr().err


def test_a_table_that_cannot_be_written_is_named(tmp_path, capsys, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "s.toml").write_text(TEXT)
    monkeypatch.setattr("hammerstein.commands.scenarios._Csv.add", full)
    assert called("sweep", tmp_path / "s.toml", "--out", tmp_path / "o.csv") == 2
    assert f"{tmp_path / 'o.csv'}: cannot be written (no space left on device)" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["s.toml"]


def test_who_watches_a_sweep_sees_how_far_it_is(tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text(TEXT)
    seen = []
    told = staticmethod(lambda what, done, of: seen.append((done, of)))
    monkeypatch.setattr(terminal.Watch, "progress", told)
    assert called("sweep", tmp_path / "s.toml", "--out", tmp_path / "o.csv", "--fresh") == 0
    assert seen == [(number, 8) for number in range(1, 9)]


def test_a_sweep_of_hours_asks_who_watches(tmp_path, capsys, monkeypatch):
    (tmp_path / "s.toml").write_text(TEXT.replace("= 8", "= 1048576"))
    for stream in ("stdin", "stderr"):
        monkeypatch.setattr(f"sys.{stream}.isatty", lambda: True, raising=False)
    assert called("sweep", tmp_path / "s.toml", "--out", tmp_path / "o.csv") == 2
    assert "start it anyway with --yes" in capsys.readouterr().err
    assert not (tmp_path / "o.csv").exists()


SECOND = """
import os, signal, sys
from hammerstein.commands.cli import main
from hammerstein.experiment import study
def killed(*_): os.kill(os.getpid(), signal.SIGKILL)
if sys.argv.pop(1) == "killed":
    study.rows_alone = killed
main(sys.argv[1:])
"""


def beside(how, *arguments):
    """Another process that sweeps: its exit code, and what it says."""
    command = [sys.executable, "-c", SECOND, how, "sweep", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    return done.returncode, done.stderr


@pytest.mark.full
def test_two_sweeps_never_mix_in_one_file(tmp_path, monkeypatch):
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "cache"))
    (tmp_path / "s.toml").write_text(TEXT)
    (tmp_path / "few.toml").write_text(TEXT.replace("= 8", "= 2"))
    others, real = [], study.rows_alone

    def interfered(*arguments):
        if not others:
            others.append(beside("whole", tmp_path / "few.toml", "--out", tmp_path / "o.csv"))
            others.append(beside("whole", tmp_path / "few.toml", "--out", tmp_path / "p.csv"))
        return real(*arguments)

    monkeypatch.setattr(study, "rows_alone", interfered)
    assert called("sweep", tmp_path / "s.toml", "--out", tmp_path / "o.csv", "--jobs", "1") == 0
    (refused, said), (fine, _) = others
    assert refused == 2
    assert f"another sweep is writing {tmp_path / 'o.csv'}" in said
    assert fine == 0
    for name, runs in (("o.csv", 8), ("p.csv", 2)):
        assert sorted(pd.read_csv(tmp_path / name)["sample"].unique()) == list(range(1, runs + 1))


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["o.csv", "o.parquet"])
def test_a_killed_sweep_leaves_nothing(tmp_path, monkeypatch, name):
    if name.endswith(".parquet"):
        pytest.importorskip("pyarrow")
    monkeypatch.setenv("HAMMERSTEIN_CACHE", str(tmp_path / "cache"))
    place = tmp_path / "work"
    place.mkdir()
    (tmp_path / "s.toml").write_text(TEXT)
    assert beside("killed", tmp_path / "s.toml", "--out", place / name)[0] == -signal.SIGKILL
    assert list(place.iterdir()) == []
