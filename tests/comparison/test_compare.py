"""Every kind of model on the same records: theory stands beside what is found, and what cannot be is told."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import stack_cases
import theory

import hammerstein
from hammerstein.commands.cli import main
from hammerstein.comparison.compare import SETTLING
from hammerstein.comparison.result import Left
from hammerstein.errors import IdentificationError
from hammerstein.identification.identify import from_last_rest
from hammerstein.identification.options import identifiable_kinds
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.reporting.compare_page import compare_page, next_command, write_comparison

T = 2e-3
R = np.array([0.0, 3.0, 8.0, 20.0, 35.0])
W = [0.5, 0.1, 0.15, 0.1, 0.12]
Q = np.array([25.0, 50.0, 75.0])
B = [-0.15, 0.25, 0.2]
NOISE_UM = 0.05
PLAIN = Settings(thresholds_v=R, dynamics="none", delay_samples=0, creep_modes=0, error_curve=False)


def record_of(hz: float, seed: int, samples: int = 2000, last: float = 0.4) -> Record:
    """A stack with dead-zones from 0 to 100 V, from rest at 10 V."""
    angle = 2.0 * np.pi * hz * T * np.arange(samples)
    swing = np.linspace(1.0, last, samples) * (1.0 - np.exp(-angle))
    sent = 10.0 + 45.0 * (1.0 - np.cos(angle)) * swing
    v = theory.asymmetric([sent], [[R]], [[W]], [[Q]], [[B]], [10.0])
    y = v + NOISE_UM * np.random.default_rng(seed).standard_normal(v.shape) + 3.0
    return Record([sent], y, T, ("u",), ("x",), f"{hz:g}Hz_{seed}.csv")


@pytest.fixture(scope="module")
def found() -> hammerstein.Comparison:
    records = [record_of(2.0, 1), record_of(10.0, 2)]
    return hammerstein.compare(records, PLAIN, validation=[record_of(2.0, 3), record_of(10.0, 4)])


def test_every_kind_has_its_place(found: hammerstein.Comparison) -> None:
    hysteresis = {entry.hysteresis for entry in found.entries} | {one.hysteresis for one in found.failed}
    assert hysteresis == {"none", *identifiable_kinds()}
    assert [entry.parameters for entry in found.entries] == sorted(e.parameters for e in found.entries)
    assert found["linear gain"].parameters == 1
    assert found["prandtl_ishlinskii"].parameters == 2 * len(R)


def test_a_kind_of_the_one_fit_is_compared_by_its_name(found: hammerstein.Comparison) -> None:
    ours = found["generalised"]
    assert isinstance(ours.model.hysteresis, hammerstein.Generalised)
    assert ours.validation is not None
    assert ours.validation.rms_um[0] < found["prandtl_ishlinskii"].validation.rms_um[0]


def test_the_kind_that_the_actuator_is_leaves_its_noise_and_is_recommended(
    found: hammerstein.Comparison,
) -> None:
    ours = found["asymmetric"]
    assert found.recommended == "asymmetric"
    assert ours.validation is not None
    assert ours.validation.rms_um[0] == pytest.approx(NOISE_UM, rel=0.1)
    assert found["prandtl_ishlinskii"].validation.rms_um[0] > 5.0 * NOISE_UM
    assert found["linear gain"].validation.rms_um[0] > found["prandtl_ishlinskii"].validation.rms_um[0]


def test_each_model_has_its_own_flags() -> None:
    """Loops so wide that a line misses them by more than a tenth of the range; plays follow."""
    u = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 300) * np.linspace(1.0, 0.4, 1200)
    wide = theory.asymmetric([u], [[np.array([0.0, 6.0])]], [[[0.1, 1.0]]], [[[]]], [[[]]], [0.0])
    settings = Settings(thresholds_v=[0.0, 6.0], dynamics="none", delay_samples=0, error_curve=False)
    found = hammerstein.compare([Record([u], wide, T, ("u",), ("x",), "wide.csv")], settings)
    assert any(flag.startswith("the error of") for flag in found["linear gain"].flags)
    assert found["prandtl_ishlinskii"].flags == ()


def test_errors_stand_at_the_frequency_of_their_record(found: hammerstein.Comparison) -> None:
    """The range of each record alone, by theory; the noise is the same in both."""
    assert found.frequencies_hz == (2.0, 10.0)
    for hz, seed in ((2.0, 3), (10.0, 4)):
        span = float(np.ptp(record_of(hz, seed).y_um))
        there = found["asymmetric"].validation_at[hz]
        assert there.rms_um[0] == pytest.approx(NOISE_UM, rel=0.2)
        assert there.mean_percent == pytest.approx(100.0 * there.rms_um[0] / span, rel=2e-3)


def test_a_compensator_is_played_on_another_kind_and_leaves_what_theory_says(
    found: hammerstein.Comparison,
) -> None:
    for entry in found.entries:
        if entry.name == found.best:
            assert entry.left.reason == "this model replaces the actuator"
            assert entry.left.words == "plant"
            continue
        assert entry.left.percent is not None, entry.left.reason
        assert entry.left.on == found.best  # one and the same, or the figures could not be compared
    linear, other = found["linear gain"], found["asymmetric"]
    assert linear.left.on == "asymmetric"
    block = other.model.hysteresis
    (pair,), (zones,) = block.plays.pairs[0], block.zones[0]
    known = linear.model.recorded
    rest, (low,), (high,) = known.working_point_v, known.lowest_v, known.highest_v
    gain = linear.model.hysteresis.pairs[0][0].weights_um_per_v[0]

    def stack(sent: np.ndarray) -> np.ndarray:
        return theory.asymmetric(
            [sent],
            [[pair.thresholds_v]],
            [[pair.weights_um_per_v]],
            [[zones.breakpoints_v]],
            [[zones.weights_um_per_v]],
            rest,
        )[0]

    errors, spans = [], []
    for record in from_last_rest([record_of(2.0, 3), record_of(10.0, 4)]):
        path, first = stack(record.u_v[0] + record.rest_v[0]), int(SETTLING * record.samples)
        sent = np.clip(rest[0] + path / gain, low - 0.1 * (high - low), high + 0.1 * (high - low))
        error = (stack(sent) - path)[first:]
        errors.append(error - error.mean())
        spans.append(np.ptp(path[first:]))
    percent = 100.0 * np.sqrt(np.mean(np.concatenate(errors) ** 2)) / max(spans)
    assert linear.left.percent == pytest.approx(percent, rel=1e-9)


@pytest.mark.long
def test_processes_side_by_side_change_no_number(found: hammerstein.Comparison) -> None:
    records = [record_of(2.0, 1), record_of(10.0, 2)]
    held = [record_of(2.0, 3), record_of(10.0, 4)]
    again = hammerstein.compare(records, PLAIN, validation=held, jobs=2)
    assert again.to_json() == found.to_json()
    assert compare_page(again).markdown() == compare_page(found).markdown()


def test_one_frequency_has_no_table_of_its_own(found: hammerstein.Comparison) -> None:
    """A multisine's record has a mean frequency, and repeating the table above under it said nothing."""
    assert "## Errors at each frequency" in compare_page(found).markdown()
    only = [
        dataclasses.replace(one, fitted_at=dict([*one.fitted_at.items()][:1]), validation_at={})
        for one in found.entries
    ]
    page = compare_page(dataclasses.replace(found, entries=tuple(only))).markdown()
    assert "## Errors at each frequency" not in page
    assert "## Inverses" in page


def test_every_model_has_its_file_and_the_next_command_drives_the_recommended_one(
    found: hammerstein.Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The model of the file predicts the actuator, by theory, within its noise; its drive follows a path."""
    monkeypatch.chdir(tmp_path)
    write_comparison(found, Path("all"), figures=False)
    named = {entry.name: f"{entry.name.replace(' ', '_')}.json" for entry in found.entries}
    kinds = {name: HammersteinModel.load(Path("all", file)) for name, file in named.items()}
    for entry in found.entries:  # each with its own error, so that no drive of it is "untested"
        verdict = kinds[entry.name].verdict
        assert verdict is not None
        assert verdict.held_out
        assert entry.validation is not None
        assert verdict.nrmse_percent == pytest.approx(entry.validation.nrmse_percent, rel=0.05)
    record = record_of(10.0, 4)
    predicted = kinds["asymmetric"].simulate(record.u_v, T).position_um
    left = (predicted - record.y_um)[0, 500:]
    assert left.std() == pytest.approx(NOISE_UM, rel=0.1)
    t = T * np.arange(1000)
    path = np.column_stack([t, 40.0 * np.sin(0.25 * np.pi * t) ** 2 + 8.0 * np.sin(0.5 * np.pi * t) ** 2])
    np.savetxt("path.csv", path, delimiter=",", header="t_s,x_um", comments="")
    program, *words = shlex.split(next_command(found, Path("all")))
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert (program, ended.value.code) == ("hammerstein", 0)
    sent = np.genfromtxt("drive.csv", delimiter=",", names=True)["drive_u_v"]
    reached = theory.asymmetric([sent], [[R]], [[W]], [[Q]], [[B]], [10.0])[0]
    error = reached[-500:] - path[-500:, 1]
    assert (error - error.mean()).std() < NOISE_UM


def test_without_held_records_it_says_that_nothing_was_tested() -> None:
    alone = hammerstein.compare([record_of(5.0, 1, last=1.0)], PLAIN)
    assert alone["asymmetric"].validation is None
    assert alone.frequencies_hz == (5.0,)
    assert "--validate" in " ".join(alone.sentences())
    assert (
        "| fitted [%] | cross-validation [%] | as good |" in compare_page(alone).markdown()
    )  # no empty column
    (one,) = (one for one in alone.failed if one.hysteresis == "rate_dependent")
    assert "one rate" in one.reason


def test_a_model_that_is_better_on_the_validation_record_alone_is_named(
    found: hammerstein.Comparison,
) -> None:
    """The figure shows the other one ahead, so that a reader would doubt the recommendation."""
    chosen, other = found[found.recommended], next(e for e in found.entries if e.name != found.recommended)
    assert chosen.validation is not None
    assert "by chance" not in " ".join(found.sentences())
    half = tuple(0.5 * percent for percent in chosen.validation.nrmse_percent)
    lucky = dataclasses.replace(other, validation=dataclasses.replace(chosen.validation, nrmse_percent=half))
    entries = tuple(lucky if entry is other else entry for entry in found.entries)
    said = " ".join(dataclasses.replace(found, entries=entries).sentences())
    folds = f"{other.folds_percent:.3g} % in cross-validation, which decides"
    assert f"{other.name} has {np.mean(half):.3g} %, but {folds}" in said


@pytest.mark.long
def test_the_linear_block_of_plays_is_tried_with_every_kind() -> None:
    """The stack behind a low-pass of 5 ms, by theory a first-order recursion."""

    def late(hz: float, seed: int) -> Record:
        record, a = record_of(hz, seed), np.exp(-T / 5e-3)
        y = record.y_um[0] - 3.0
        for k in range(1, y.size):  # a voltage is held from sample to sample
            y[k] = a * y[k - 1] + (1.0 - a) * (record.y_um[0, k - 1] - 3.0)
        return Record(record.u_v, [y], T, ("u",), ("x",), record.source)

    records = [late(2.0, 1), late(20.0, 2)]
    settings = Settings(thresholds_v=R, creep_modes=0, error_curve=False)
    found = hammerstein.compare(records, settings, validation=[late(3.0, 3)])
    assert found.recommended == "asymmetric with dynamics"
    dynamics = found[found.recommended].model.dynamics
    assert dynamics.axes[0].lag_s == pytest.approx(5e-3, rel=0.05)
    static = found["asymmetric"].validation
    assert found[found.recommended].validation.rms_um[0] < 0.3 * static.rms_um[0]


@pytest.mark.long
def test_a_kind_has_the_dynamics_that_identify_finds_behind_it() -> None:
    """Lag, resonance and creep of a stack, of which its dead-zones hide the most from plays."""

    def record(hz: float, seconds: float, seed: int) -> Record:
        u, y = stack_cases.record_um(hz, seconds, seed)
        return Record(u, y, 1.0 / stack_cases.RATE_HZ, ("u",), ("x",), f"{hz:g}.csv")

    found = hammerstein.compare(
        [record(20.0, 1.0, 1), record(100.0, 0.5, 2)], validation=[record(40.0, 0.8, 3)]
    )
    assert found.recommended == "asymmetric with dynamics"
    assert (
        found[found.recommended].validation.nrmse_percent[0] < 0.05
    )  # 0.2 behind the block that suits plays


def test_records_that_no_kind_can_be_fitted_to_are_refused() -> None:
    u = 10.0 * np.sin(np.arange(800) / 40.0)
    noise = np.random.default_rng(0).standard_normal((1, 800))
    with pytest.raises(IdentificationError):
        hammerstein.compare([Record([u], noise, T)], PLAIN)


# On the command line ----------------------------------------------------------------------------------------

COLUMNS = ("--inputs", "u", "--outputs", "x", "--time", "t")
QUICK = ("--thresholds", "0,3,8,20,35", "--dynamics", "none", "--delay-samples", "0", "--jobs", "1")


def call(*words: object) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in words])
    return int(caught.value.code or 0)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    monkeypatch.chdir(tmp_path)
    for name, record in (
        ("a.csv", record_of(2.0, 1)),
        ("b.csv", record_of(10.0, 2)),
        ("c.csv", record_of(2.0, 3)),
    ):
        table = np.column_stack([np.arange(record.samples) * T, record.u_v[0], record.y_um[0]])
        lines = (",".join(f"{value:.9g}" for value in row) for row in table)
        Path(name).write_text("t,u,x\n" + "\n".join(lines) + "\n")
    return "a.csv", "b.csv", "c.csv"


def test_the_command_writes_pages_figure_and_numbers(
    files: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    slow, fast, held = files
    assert call("compare", slow, fast, "--validate", held, *COLUMNS, *QUICK) == 0
    printed = capsys.readouterr().out
    assert "Recommended: asymmetric" in printed
    written = {path.name for path in Path("compare").iterdir()}
    assert {"compare.md", "compare.html", "compare.json", "compare.svg"} <= written
    content = json.loads(Path("compare/compare.json").read_text())
    page, html = (Path(f"compare/compare.{end}").read_text() for end in ("md", "html"))
    for model in content["models"]:
        assert model["name"] in page
        assert model["name"] in html
        assert model["name"] in printed.replace("\n", " ")
    assert content["held_records"] == ["c.csv"]
    assert call("show", "compare/compare.json") == 0
    assert "asymmetric" in capsys.readouterr().out


@pytest.mark.full
def test_a_comparison_without_a_figure_takes_away_that_of_another(
    files: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    slow, fast, held = files
    assert call("compare", slow, fast, "--validate", held, *COLUMNS, *QUICK) == 0
    assert Path("compare/compare.svg").exists()
    before = {path.name: path.read_bytes() for path in Path("compare").iterdir()}
    assert call("compare", slow, fast, "--validate", held, *COLUMNS, *QUICK) == 0
    assert {path.name: path.read_bytes() for path in Path("compare").iterdir()} == before
    capsys.readouterr()
    assert call("compare", slow, fast, *COLUMNS, *QUICK, "--no-figures", "--json") == 0
    assert json.loads(capsys.readouterr().out)["held_records"] == []
    assert not Path("compare/compare.svg").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--validate", "a.csv"), "is also a fitted record"),
        (("--dynamics", "quick"), "--dynamics"),
        (("--operators", "many"), "must be a whole number or 'auto', not 'many'"),
        (("--out", "a.csv"), "a.csv"),
    ],
)
def test_mistakes_are_told_and_nothing_is_written(
    files: tuple[str, ...], capsys: pytest.CaptureFixture[str], words: tuple[str, ...], says: str
) -> None:
    before = sorted(path.name for path in Path().iterdir())
    assert call("compare", "a.csv", *COLUMNS, *words) == 2
    error = capsys.readouterr().err
    assert says in error
    assert "Traceback" not in error
    assert sorted(path.name for path in Path().iterdir()) == before


def test_other_peoples_files_stay(files: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    Path("compare").mkdir()
    Path("compare/compare.md").write_text("my own notes")
    assert call("compare", *files, *COLUMNS, *QUICK) == 2
    assert "compare.md" in capsys.readouterr().err
    assert Path("compare/compare.md").read_text() == "my own notes"


def test_a_method_that_only_plays_have_is_a_reason_in_a_row(
    files: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("compare", "a.csv", *COLUMNS, *QUICK[2:], "--solver", "closed_form", "--no-figures") == 0
    printed = capsys.readouterr()
    assert "closed_form cannot be used with hysteresis asymmetric" in " ".join(printed.out.split())
    assert re.search(r"^comparing every kind of model on \d+ samples", printed.err, re.M)  # nobody watches


def test_a_law_that_cannot_work_has_no_error() -> None:
    assert {Left(reason="no law").words, Left("exact_inverse", "asymmetric", reason="no").words} == {"none"}
    assert Left("exact_inverse", "asymmetric", percent=0.1234).words == "0.123"
