"""What another package can add without a change in this one."""

from dataclasses import asdict, dataclass, replace
from typing import ClassVar, Literal

import control
import numpy as np
import pytest
from pydantic import Field
from typer.testing import CliRunner

import hammerstein
from hammerstein import plugins
from hammerstein.blocks import Law, Memory
from hammerstein.blocks.driving import DriveRange
from hammerstein.commands.cli import app
from hammerstein.comparison.compare import compare
from hammerstein.compensators import COMPENSATORS
from hammerstein.compensators.drive_file import Terms, compensate
from hammerstein.dynamics import discretise
from hammerstein.hysteresis import HYSTERESIS, slopes_of
from hammerstein.hysteresis.identifiable import Identifiable, Limits
from hammerstein.hysteresis.kind import SWEEP_SAMPLES
from hammerstein.identification.identify import identify
from hammerstein.identification.settings import Settings
from hammerstein.records.record import Record
from hammerstein.reporting.run_page import run_page
from hammerstein.scenario.assessment import ASSESSMENTS, Assessment, Judgement
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


CIRCLE = {"kind": "circle", "radius_um": 20.0, "frequency_hz": 10.0}


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
    with pytest.raises(hammerstein.InputError, match="can be registered"):
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


@pytest.fixture
def installed(monkeypatch):
    """Another package, installed and not yet imported, that brings a law and a kind of hysteresis."""

    class Entry:
        def __init__(self, kind):
            self.kind = kind

        def load(self):
            return self.kind

    entries = [Entry(Doubtful), Entry(FollowerFile)]
    monkeypatch.setattr(plugins, "entry_points", lambda group: entries)
    plugins.load_plugins.cache_clear()
    yield
    for family, kind in ((COMPENSATORS, Doubtful), (HYSTERESIS, FollowerFile)):
        family.remove(kind)
    plugins.load_plugins.cache_clear()


@pytest.fixture
def followed(follower):
    """A model file of that kind, which nothing of this process has registered."""
    HYSTERESIS.remove(FollowerFile)
    return follower[1]


def test_a_kind_that_is_installed_is_found_when_its_name_is_read(installed, followed):
    assert hammerstein.HammersteinModel.load(followed).hysteresis.gains == (5.0, 4.0)


@pytest.mark.parametrize("command", ["show", "play"])
def test_commands_find_it_when_its_name_is_read(installed, followed, tmp_path, command):
    (tmp_path / "drive.csv").write_text(
        "time_s,u_x,u_y\n" + "".join(f"{k * 1e-3!r},{k % 5},0\n" for k in range(20))
    )
    asked = {
        "show": [followed],
        "play": [followed, str(tmp_path / "drive.csv"), "--out", str(tmp_path / "played.csv")],
    }
    result = CliRunner().invoke(app, [command, *asked[command]])
    assert result.exit_code == 0, f"{result.output}{result.exception}"


@pytest.mark.parametrize("command", ["compensate", "export"])
def test_a_law_that_is_installed_takes_its_own_options(installed, tmp_path, command):
    (tmp_path / "path.csv").write_text(
        "time_s,x,y\n" + "".join(f"{k * 5e-5!r},{0.1 * k},0\n" for k in range(40))
    )
    path = [str(tmp_path / "path.csv")] if command == "compensate" else []
    base = [command, "duo_bimorph_static", *path, "--law", "doubtful", "--out", str(tmp_path / "out")]

    def said(*options):
        result = CliRunner().invoke(app, [*base, *options])
        return result.exit_code, f"{result.output}{result.exception}"

    assert "--option gain_v_per_um" in said("--option", "gain_v_per_um=0")[1]
    assert "did you mean gain_v_per_um" in said("--option", "gain_v_per_u=0.2")[1]
    assert "given twice" in said("--option", "gain_v_per_um=0.2", "--option", "gain_v_per_um=0.1")[1]
    assert "write KEY=VALUE" in said("--option", "gain_v_per_um")[1]
    if command == "compensate":
        assert said("--option", "gain_v_per_um=0.2")[0] == 0
        lines = [line for line in (tmp_path / "out").read_text().splitlines() if not line.startswith("#")]
        found = np.array([line.split(",")[1] for line in lines[1:]], dtype=float)  # behind the time
        np.testing.assert_allclose(found, 0.02 * np.arange(40), atol=2e-3)
    else:
        assert "law" not in said("--option", "gain_v_per_um=0.2")[1].partition("is not one of")[1]


@dataclass(frozen=True)
class Kept(Judgement):
    """Whether a limit is kept."""

    worst_um: float
    limit_um: float

    @property
    def agrees(self):
        return self.worst_um <= self.limit_um

    def cells(self):
        return {"limit": self.id, "found": f"{self.worst_um:.3g} um", "verdict": str(self.agrees)}

    def numbers(self):
        yield {"limit": self.id}, {"worst_of_all_um": self.worst_um}

    def as_dict(self):
        return asdict(self)


class DataSheet(Assessment):
    """What a data sheet promises, as another package might ask it."""

    kind: Literal["data_sheet"] = "data_sheet"
    title: ClassVar[str] = "Promises of the data sheet"
    number_names: ClassVar[tuple[str, ...]] = ("worst_of_all_um",)
    limit_um: float

    def judge(self, scenario, name, model, rows, store):
        return (Kept("error", max(row.max_true_um for row in rows), self.limit_um),)

    def judgement_of(self, content):
        return Kept(**content)


@pytest.fixture
def data_sheet():
    yield hammerstein.register(DataSheet)
    ASSESSMENTS.remove(DataSheet)


def test_an_assessment_from_outside_has_judgement_page_tolerance_and_baseline(data_sheet, tmp_path):
    asked = {
        "question": "Does it keep what is promised?",
        "actuator": "duo_bimorph_static",
        "reference": {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 50.0},
        "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
        "tolerances": {"worst_of_all_um": {"relative": 0.5}},
        "assessment": {"kind": "data_sheet", "limit_um": 1e-4},
    }
    report = hammerstein.run(asked)
    (judgement,) = report.judgements
    assert judgement.worst_um == report.to_frame()["max_true_um"].max()
    assert not judgement.agrees
    assert "## Promises of the data sheet" in run_page(report).markdown()
    assert "Promises of the data sheet" in run_page(report).html({})
    baseline = tmp_path / "promised.json"
    hammerstein.check(asked, baseline, update=True)
    assert "worst_of_all_um" in baseline.read_text()
    assert hammerstein.check(asked, baseline).exit_code == 0


class Doubtful(hammerstein.Compensator):
    """Asks for a fixed gain on the diagonal, as another package's law might."""

    law: Literal["doubtful"] = "doubtful"
    gain_v_per_um: float = Field(default=0.1, gt=0.0)

    def design(self, model, range_v, sample_time_s):
        return DoubtfulLaw(model, range_v, self.gain_v_per_um)


class DoubtfulLaw(Law):
    def __init__(self, model, range_v, gain):
        self.n_inputs, self.n_outputs = model.hysteresis.n_inputs, model.hysteresis.n_outputs
        self.range, self.gain, self.origin_um = DriveRange.of(range_v, model), gain, np.zeros(self.n_outputs)

    def rest(self):
        return Memory()

    def _respond(self, reference_um, start):
        return self.gain * reference_um, start


@pytest.fixture
def doubtful():
    yield hammerstein.register(Doubtful)
    COMPENSATORS.remove(Doubtful)


def test_a_compensator_of_another_package_is_named_by_a_scenario(doubtful):
    own = {"label": "own", "law": "doubtful", "gain_v_per_um": 0.2, "model": "duo_bimorph_static"}
    circle = {"kind": "circle", "radius_um": 20.0, "frequency_hz": 10.0}
    response = hammerstein.simulate({**SCAN, "reference": circle, "compensators": [own]})
    np.testing.assert_array_equal(response.requested_v, 0.2 * response.reference_um)
    wrong = {**SCAN, "reference": circle, "compensators": [own | {"gain_v_per_um": 0.0}]}
    with pytest.raises(hammerstein.InputError, match=r"compensators\[1\].gain_v_per_um"):
        hammerstein.run(wrong)


def test_it_serves_the_drive_file_too(doubtful, tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("time_s,x,y\n0,0,0\n0.01,1,0\n0.02,2,1\n")
    found = compensate("duo_bimorph_static", path, "doubtful", {"gain_v_per_um": 0.2}, Terms(clip=True))
    np.testing.assert_allclose(found.drive_v[0].max(), 0.4, atol=2e-4)  # half a step of the converter


@dataclass(frozen=True, eq=False)
class Lag(Memory):
    """What a relaxing magnet remembers: the part of its voltage (m,) that has not been followed yet."""

    behind_v: np.ndarray


@dataclass(frozen=True, eq=False)
class Follower(hammerstein.Hysteresis, Identifiable):
    """Follows each voltage with a gain, and lags behind it by a share of the last step: a kind with memory.

    With a lag of zero it is linear, so that theory knows all that follows. Its lag is a free number.
    """

    kind = "follower"
    n_beside_weights = 1
    gains: tuple[float, ...]
    lag: float
    weight_covariance = None

    n_inputs = property(lambda self: len(self.gains))
    n_outputs = property(lambda self: len(self.gains))
    operators = property(
        lambda self: tuple(tuple(int(o == k) for k in range(self.n_inputs)) for o in range(self.n_outputs))
    )
    weights = property(lambda self: tuple(np.array([g]) for g in self.gains))

    free = property(lambda self: np.array([self.lag]))

    @classmethod
    def first_guesses(cls, driven):
        return [cls((1.0,) * driven.outputs, 0.1)]

    def at(self, free):
        return replace(self, lag=float(free[0]))

    def limits(self, driven):
        return Limits(np.array([0.0]), np.array([0.9]))

    def describe(self):
        return f"follows {self.n_inputs} inputs"

    def rest(self):
        return Lag(np.zeros(self.n_inputs))

    def with_weights(self, weights):
        return replace(self, gains=tuple(float(w[0]) for w in weights))

    def file(self):
        return FollowerFile(gains=self.gains, lag=self.lag)

    def _respond(self, u_v, start):
        before = np.hstack([start.behind_v[:, None], u_v])[:, :-1]
        mixed = (1.0 - self.lag) * u_v + self.lag * before
        return np.array(self.gains)[:, None] * mixed, Lag(u_v[:, -1].copy())


class FollowerFile(hammerstein.HysteresisFile):
    """Its form in a model file."""

    kind: Literal["follower"] = "follower"
    describes: ClassVar = Follower
    gains: tuple[float, ...]
    lag: float = Field(default=0.0, ge=0.0, lt=1.0)

    def hysteresis(self):
        return Follower(self.gains, self.lag)


@pytest.fixture
def follower(tmp_path):
    hammerstein.register(FollowerFile)
    axes = hammerstein.AxesDynamics(axes=(hammerstein.Axis(resonance_hz=430.0, damping_ratio=0.1),) * 2)
    names = (("u_x", "u_y"), ("x", "y"))
    model = hammerstein.HammersteinModel("followed", Follower((5.0, 4.0), 0.25), axes, 10.0, *names)
    path = tmp_path / "followed.json"
    model.save(path)
    yield model, str(path)
    HYSTERESIS.remove(FollowerFile)


def test_a_hysteresis_of_another_package_is_saved_and_loaded(follower):
    model, path = follower
    again = hammerstein.HammersteinModel.load(path)
    assert again.digest() == model.digest()
    assert again.hysteresis.gains == (5.0, 4.0)
    other = replace(model, hysteresis=Follower((5.0, 4.0), 0.5))
    assert other.digest() != model.digest()


def followed_records(tmp_path):
    """Records of the follower, one input at a time, as arrays and in files."""
    u = 5.0 * np.sin(np.arange(600) / 15.0) * np.linspace(1.0, 0.4, 600)
    found = []
    for k in range(2):
        both = np.zeros((2, 600))
        both[k] = u
        y = Follower((5.0, 4.0), 0.25)._respond(both, Lag(np.zeros(2)))[0]
        noisy = y + 0.01 * np.random.default_rng(k).standard_normal(y.shape)
        found.append(Record(both, noisy, 1e-3, ("u_x", "u_y"), ("x", "y"), f"{k}.csv"))
        rows = "\n".join(",".join(f"{v:.9g}" for v in row) for row in np.vstack([both, noisy]).T)
        (tmp_path / f"{k}.csv").write_text(f"u_x,u_y,x,y\n{rows}\n")
    return found


@pytest.mark.full
def test_a_kind_of_another_package_is_identified_by_its_name(follower, tmp_path, monkeypatch):
    """In Python, on the command line, and beside the others in a comparison."""
    records = followed_records(tmp_path)
    kept = {"dynamics": "none", "delay_samples": 0, "error_curve": False, "operators": 4}
    model, fit = identify(records, Settings(hysteresis="follower", **kept))
    assert model.hysteresis.lag == pytest.approx(0.25, abs=0.005)
    np.testing.assert_allclose(model.hysteresis.gains, (5.0, 4.0), rtol=1e-3)
    assert fit.fit["static_hysteresis"].rms_um == pytest.approx((0.01, 0.01), rel=0.1)
    monkeypatch.chdir(tmp_path)
    words = ["identify", "0.csv", "1.csv", "--rate", "1000", "--inputs", "u_x,u_y", "--outputs", "x,y"]
    words += ["--hysteresis", "follower", "--dynamics", "none", "--delay-samples", "0", "--no-figures"]
    done = CliRunner().invoke(app, [*words, "--out", "m.json"])
    assert done.exit_code in (0, 4), done.output  # flagged or not, it is no internal error
    assert hammerstein.HammersteinModel.load("m.json").hysteresis.lag == pytest.approx(0.25, abs=0.005)
    found = compare(records, Settings(**kept))
    assert found["follower"].judged.mean_percent < 0.2


@pytest.mark.full
def test_a_kind_of_another_package_is_identified_with_the_dynamics_behind_it(follower):
    """Its own free number and the resonance are found together, by name, alone and in a comparison."""
    time = np.arange(2000) * 1e-3
    u = 5.0 * np.sin(2.0 * np.pi * (2.0 * time + 20.0 * time**2)) * np.minimum(1.0, 20.0 * time)
    axes = hammerstein.AxesDynamics(axes=(hammerstein.Axis(resonance_hz=60.0, damping_ratio=0.1),))
    v = Follower((5.0,), 0.25)._respond(u[None], Lag(np.zeros(1)))[0]
    y = discretise(axes, 1e-3).respond(v)[0][-1:]
    y += 0.01 * np.random.default_rng(0).standard_normal(y.shape)
    records = [Record([u], y, 1e-3, ("u",), ("x",), "sweep.csv")]
    kept = {"dynamics": "second_order", "creep_modes": 0, "delay_samples": 0, "error_curve": False}
    model, fit = identify(records, Settings(hysteresis="follower", **kept))
    assert model.dynamics.axes[0].resonance_hz == pytest.approx(60.0, rel=1e-3)
    assert model.dynamics.axes[0].damping_ratio == pytest.approx(0.1, rel=0.01)
    assert model.hysteresis.lag == pytest.approx(0.25, abs=0.01)
    assert fit.fit["hammerstein"].rms_um[0] == pytest.approx(0.01, rel=0.1)
    entry = compare(records, Settings(**kept, operators=4))["follower with dynamics"]
    assert entry.judged.mean_percent == pytest.approx(fit.fit["hammerstein"].mean_percent, rel=0.05)


def test_what_any_hysteresis_has_is_worked_out_where_a_kind_does_not_say(follower):
    model, _ = follower
    np.testing.assert_allclose(model.hysteresis.gain(3.0), np.diag([5.0, 4.0]), rtol=1e-2)
    low, high = model.hysteresis.extremes(np.array([-1.0, 0.0]), np.array([3.0, 2.0]))
    lag = 0.25 * 4.0 / SWEEP_SAMPLES  # a quarter of a step between the ends, 4 V apart; 3 and 2 V from rest
    np.testing.assert_allclose(low, [-5.0 * (1.0 - lag), 0.0], atol=1e-12)
    np.testing.assert_allclose(high, [5.0 * (3.0 - 0.75 * lag), 4.0 * (2.0 - 0.5 * lag)], atol=1e-12)
    slopes = slopes_of(model.hysteresis, 1, 3.0)
    np.testing.assert_allclose(np.median(slopes, axis=0), [0.0, 4.0], atol=1e-9)


@pytest.mark.parametrize(
    "law",
    [
        {"law": "none"},
        {"law": "inverse_multiplicative", "iterations": 20},
        pytest.param({"law": "feedback"}, marks=pytest.mark.full),
        {"law": "feedback", "feedforward": "none"},
    ],
)
def test_it_runs_under_every_law_that_can_take_it(follower, law):
    _, path = follower
    own = {"label": "own", "model": path, **law}
    circle = {"kind": "circle", "radius_um": 20.0, "frequency_hz": 20.0}
    scenario = {**SCAN, "actuator": path, "reference": circle, "compensators": [own]}
    scenario["uncertainty"] = {"draws": 2, "weights": 0.01}
    report = hammerstein.run(scenario)
    worst = max(row.rms_true_um for row in report.rows)
    assert 0.0 < worst < (1.0 if law["law"] != "feedback" else 10.0)  # um of a 20 um circle


def test_the_plain_loop_is_the_compiled_one(follower):
    """The law's loop for any kind against its compiled form for plays, on a hysteresis that both know."""
    table = hammerstein.HammersteinModel.load("duo_bimorph_static")

    class Wrapped(Follower):
        wipes_out = True
        n_inputs = property(lambda self: 2)
        operators = property(lambda self: table.hysteresis.operators)
        slope_columns = staticmethod(table.hysteresis.slope_columns)
        rest, restore = staticmethod(table.hysteresis.rest), staticmethod(table.hysteresis.restore)

        def respond(self, u_v, start=None):
            return table.hysteresis.respond(u_v, start)

    law = hammerstein.InverseMultiplicative(iterations=3)
    plain = law.design(replace(table, hysteresis=Wrapped((1.0, 1.0), 0.0)), 10.0, 50e-6)
    angle = np.linspace(0.0, 20.0, 500)
    path = 20.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)])
    compiled = law.design(table, 10.0, 50e-6)
    np.testing.assert_allclose(plain.respond(path)[0], compiled.respond(path)[0], atol=1e-12)


def test_a_law_that_needs_more_names_kind_and_want(follower):
    _, path = follower
    for law, want in (("exact_inverse", "no exact inverse"), ("decoupled_inverse", "inverts plays only")):
        own = {"label": "own", "law": law, "model": path}
        with pytest.raises(hammerstein.InputError, match=want) as told:
            hammerstein.run({**SCAN, "actuator": path, "reference": CIRCLE, "compensators": [own]})
        assert "'follower'" in str(told.value)


def test_python_control_takes_it_too(follower):
    model, _ = follower
    u = np.random.default_rng(0).normal(size=(2, 40))
    system = model.hysteresis.to_iosys(50e-6)
    response = control.input_output_response(system, 50e-6 * np.arange(40), u)
    np.testing.assert_allclose(response.outputs, model.hysteresis.respond(u)[0], atol=1e-12)
