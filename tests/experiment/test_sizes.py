"""What is too large is refused before it starts, with the largest part and what makes it smaller."""

import subprocess
import sys
import time
from typing import Literal

import numpy as np
import pytest

from hammerstein.arrays import PAGE, allocate_wires
from hammerstein.commands import cli, terminal
from hammerstein.compensators import COMPENSATORS, NoCompensation
from hammerstein.compensators.path_file import drive_csv
from hammerstein.errors import InputError, SimulationError
from hammerstein.experiment.plan import Part, Plan, jobs_that_fit, longest_first, plan_of, slowness, together
from hammerstein.experiment.run import run, simulate
from hammerstein.experiment.set_up import Window, plant_of
from hammerstein.plugins import load_plugins, register
from hammerstein.runtime import resources
from hammerstein.scenario import Scenario


def _scenario(law="inverse_multiplicative", options=(), identification=None, **tables):
    source = {"model": "duo_bimorph"} if identification is None else {"identification": identification}
    content = {
        "question": "?",
        "reference": {"kind": "sine", "amplitude_um": 10.0, "frequency_hz": 50.0},
        "compensators": [{"label": "a", "law": law, **source, **dict(options)}],
        **tables,
    }
    return Scenario.model_validate(content)


MANY = [1.0 + 0.001 * i for i in range(5000)]
LARGE = {
    "record_s": (
        {"identification": {"method": "hammerstein", "record_s": 1e5}},
        "identification of 'a'",
        "record_s",
    ),
    "closed form": (
        {"identification": {"measured_cycles": 10**8}},
        "identification of 'a'",
        "measured_cycles",
    ),
    "draws": ({"uncertainty": {"draws": 10**7}}, "random actuators", "uncertainty.draws"),
    "sweep": ({"sweep": {"frequency_hz": MANY, "amplitude_um": MANY}}, "5e+07 runs", "the values in [sweep]"),
    "settle": ({"measure": {"settle_cycles": 10**8}}, "runs of up to", "measure.settle_cycles"),
    "sample time": ({"instruments": {"drive": {"sample_time_s": 1e-9}}}, "runs of up to", "sample_time_s"),
}


@pytest.mark.parametrize("name", LARGE)
def test_what_does_not_fit_is_refused_before_it_starts(name, monkeypatch):
    tables, part, key = LARGE[name]
    monkeypatch.setattr("hammerstein.experiment.plan.free_bytes", lambda: 4e9)
    monkeypatch.setattr("hammerstein.experiment.run.set_up", None)  # nothing begins
    with pytest.raises(SimulationError) as caught:
        run(_scenario(**tables))
    for words in ("of memory, but 4 GB are free", part, key):
        assert words in str(caught.value)


def test_a_single_case_looks_at_its_identification_too(monkeypatch):
    monkeypatch.setattr("hammerstein.experiment.plan.free_bytes", lambda: 4e9)
    with pytest.raises(SimulationError, match="record_s"):
        simulate(_scenario(identification={"method": "hammerstein", "record_s": 1e5}))


def test_the_plan_follows_what_is_asked():
    base = plan_of(_scenario())
    assert plan_of(_scenario(sweep={"frequency_hz": [50.0, 50.5, 51.0]})).bytes > 1.5 * base.bytes
    assert plan_of(_scenario(options={"iterations": 1000})).seconds > 20 * base.seconds
    assert plan_of(_scenario(uncertainty={"draws": 2000})).seconds > 200 * base.seconds
    assert plan_of(_scenario(measure={"settle_cycles": 2000})).bytes > 50 * base.bytes
    assert plan_of(_scenario("hammerstein_inverse", {"filter_hz": 2.0})).seconds > 5 * base.seconds


def test_identifications_on_other_actuators_are_in_the_plan():
    load_plugins()  # the paper is one
    fitted = {"identification": {"method": "hammerstein"}}
    others = [{"actuator": name} for name in ("duo_bimorph_dense", "duo_bimorph_creep")]
    alone = plan_of(_scenario(**fitted))
    asked = plan_of(_scenario(**fitted, assessment={"kind": "paper", "also_on": others}))
    assert asked.seconds == pytest.approx(3.0 * alone.seconds)


def test_a_slower_processor_takes_longer(monkeypatch):
    def planned(trial_s):
        slowness.cache_clear()
        monkeypatch.setattr("timeit.repeat", lambda *_, **__: [trial_s])
        return plan_of(_scenario(uncertainty={"draws": 10})).seconds

    assert planned(3e-3) == pytest.approx(3.0 * planned(1e-3))
    slowness.cache_clear()


def test_memory_that_a_run_takes_is_what_the_plan_says():
    import tracemalloc

    scenario = _scenario("none", measure={"measured_cycles": 500})
    run(scenario)
    tracemalloc.start()
    report = run(scenario)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(report.traces) == 2
    planned = plan_of(scenario).bytes
    assert 0.4 * planned < peak < 1.2 * planned


def test_a_filter_of_too_many_samples_is_refused_at_once():
    with pytest.raises(InputError, match=r"filter_hz|at most 100000 are allowed; use 1\.\d+ Hz or more"):
        run(_scenario("hammerstein_inverse", {"filter_hz": 1e-3}))


def test_a_delay_of_too_many_samples_is_refused_at_once():
    from hammerstein.dynamics import AxesDynamics, Axis, discretise

    late = AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.1),) * 2, input_delay_s=1.0)
    with pytest.raises(InputError, match="is 20000 samples of 50 us, but at most 1000 are possible"):
        discretise(late, 50e-6)


def test_free_memory_is_what_the_tightest_limit_leaves(tmp_path, monkeypatch):
    own = tmp_path / "cgroup"
    own.write_text("0::/outer/inner\n")
    for folder, limit, used in (("outer", "1000000", "400000"), ("outer/inner", "max", "5")):
        (tmp_path / "groups" / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / "groups" / folder / "memory.max").write_text(limit + "\n")
        (tmp_path / "groups" / folder / "memory.current").write_text(used + "\n")
    monkeypatch.setattr(resources, "GROUPS", tmp_path / "groups")
    monkeypatch.setattr(resources, "OWN_GROUP", own)
    assert resources.free_bytes() == 600_000
    monkeypatch.setattr(resources, "OWN_GROUP", tmp_path / "none")
    assert resources.free_bytes() > 1e6


@pytest.mark.skipif(sys.platform != "linux", reason="limits of Linux")
def test_a_limit_on_the_addresses_counts():
    limited = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (1_500_000_000, resource.RLIM_INFINITY))"
    )
    code = f"{limited}\nfrom hammerstein.runtime.resources import free_bytes\nprint(free_bytes())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 5e8 < float(done.stdout) < 1.5e9


def test_jobs_that_do_not_fit_together_run_one_after_the_other(monkeypatch):
    plans = [plan_of(_scenario()) for _ in range(4)]
    for free, jobs in ((10.0, 4), (2.5, 2), (0.5, 1)):
        monkeypatch.setattr("hammerstein.experiment.plan.free_bytes", lambda free=free: free * plans[0].bytes)
        assert jobs_that_fit(plans, 4) == jobs


def test_long_ones_come_first_and_what_two_share_counts_for_one_of_them():
    """So that no two processes identify the same model side by side, and no one is left alone at the end."""

    def plan(seconds, **shared):
        kept = [Part("identification", 1.0, s, "record_s", once=name) for name, s in shared.items()]
        return Plan((*kept, Part("runs", 1.0, seconds, "[sweep]")))

    plans = {"a": plan(1.0, x=5.0), "b": plan(2.0, x=5.0), "c": plan(3.0), "d": plan(0.5, y=4.0, x=5.0)}
    assert longest_first(plans) == ["d", "c", "b", "a"]
    assert together(plans.values()).seconds == pytest.approx(5.0 + 4.0 + 1.0 + 2.0 + 3.0 + 0.5)


def test_what_is_identified_of_another_actuator_or_seed_is_not_shared():
    found = [
        plan_of(_scenario(identification={"method": "hammerstein"}, **more)).kept
        for more in ({}, {}, {"seed": 2}, {"actuator": "duo_bimorph_dense"}, {"question": "!"})
    ]
    assert found[0] == found[1] == found[4]
    assert len(set().union(*found)) == 3


SLOW = """
question = "?"
[reference]
kind = "sine"
amplitude_um = 10
frequency_hz = 50
[[compensators]]
label = "a"
law = "inverse_multiplicative"
iterations = 10000000
model = "duo_bimorph"
"""


def test_what_takes_long_says_so_and_wants_yes_of_a_person(tmp_path, monkeypatch, capsys):
    path = tmp_path / "slow.toml"
    path.write_text(SLOW)
    begun = []
    monkeypatch.setattr("hammerstein.experiment.run.run", lambda *_: begun.append(1) or 1 / 0)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)

    def call(watched, *options):
        monkeypatch.setattr(cli.sys.stderr, "isatty", lambda: watched, raising=False)
        monkeypatch.setattr(cli.sys.stdin, "isatty", lambda: watched, raising=False)
        monkeypatch.setattr(terminal.Watch, "__enter__", lambda self: self)
        with pytest.raises(SystemExit) as caught:
            cli.main(["run", str(path), "--out", str(tmp_path / "r"), "--jobs", "1", *options])
        return caught.value.code, capsys.readouterr().err

    code, said = call(True)
    assert code == 2
    assert "this takes about" in said
    assert "start it anyway with --yes" in said
    assert "iterations" in said
    assert begun == []
    with monkeypatch.context() as little:  # nobody is asked for what is refused in the end
        little.setattr("hammerstein.experiment.plan.free_bytes", lambda: 1e3)
        little.setattr("hammerstein.experiment.run.run", run)
        code, said = call(True)
        assert code == 3
        assert "this takes about" not in said
        assert "of memory, but 1e-06 GB are free" in said
    for watched, options in ((True, ["--yes"]), (False, [])):
        code, said = call(watched, *options)
        assert "this takes about" in said
    assert begun == [1, 1]


def test_memory_for_long_signals_lies_on_large_pages():
    few, many = allocate_wires(3, 1000), allocate_wires(6, 900_000)
    assert few.shape == (3, 1000)
    assert many.shape == (6, 900_000)
    assert many.ctypes.data % PAGE == 0
    assert all(array.flags.c_contiguous and array.flags.writeable for array in (few, many))


@pytest.mark.parametrize(("law", "times"), [("inverse_multiplicative", 50.0), ("exact_inverse", 5.0)])
def test_a_law_around_a_block_that_knows_the_rate_is_announced_as_what_it_costs(law, times):
    """Measured: more than 200 and 10 times what a run with the same law takes around plays."""

    def seconds(actuator):
        scenario = Scenario.model_validate(
            {
                "question": "How long?",
                "actuator": actuator,
                "reference": {"kind": "circle", "radius_um": 20.0, "frequency_hz": 50.0},
                "measure": {"measured_cycles": 100},
                "compensators": [{"label": "law", "law": law, "model": actuator}],
            }
        )
        return sum(part.seconds for part in plan_of(scenario).parts)

    assert seconds("rate_dependent_stack") > times * seconds("duo_bimorph")


@pytest.mark.parametrize("options", [(), ("--cycle",), ("--table", "csv")])
def test_a_path_of_two_rows_and_many_hours_is_refused_before_its_grid_is_made(
    tmp_path, monkeypatch, capsys, options
):
    """Rows 0 and 5000 s are 1e8 samples of 50 us, a period of two such rows twice as many."""
    (tmp_path / "path.csv").write_text("time_s,x_um,y_um\n0,0,0\n5000,1,1\n")
    monkeypatch.setattr("hammerstein.compensators.path_file.free_bytes", lambda: 4e9)
    arange = np.arange
    monkeypatch.setattr(np, "arange", lambda *a, **more: arange(*a, **more) if max(a) < 1e6 else 1 / 0)
    with pytest.raises(SystemExit) as caught:
        cli.main(["compensate", "duo_bimorph", str(tmp_path / "path.csv"), *options])
    assert caught.value.code == 3
    said = capsys.readouterr().err
    samples = "200,000,000" if options else "100,000,001"
    for words in (f"{samples} samples of 50 us need about", "4 GB are free", "t [ms]"):
        assert words in said


def test_a_long_path_says_its_cost_before_the_work(tmp_path, monkeypatch, capsys):
    (tmp_path / "path.csv").write_text("time_s,x_um,y_um\n0,0,0\n20,1,1\n")
    monkeypatch.setattr("hammerstein.compensators.drive_file.compensation_of", None)  # nothing begins
    with pytest.raises(SystemExit):
        cli.main(["compensate", "duo_bimorph", str(tmp_path / "path.csv")])
    assert "400,001 samples of 50 us: about 0.18 GB of memory and 6 seconds" in capsys.readouterr().err


def test_what_is_played_is_refused_by_its_size_too(tmp_path, monkeypatch, capsys):
    (tmp_path / "drive.csv").write_text("time_s,x,y\n" + "".join(f"{k / 1000},0,0\n" for k in range(2000)))
    monkeypatch.setattr("hammerstein.compensators.path_file.free_bytes", lambda: 1e5)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        cli.main(["play", "duo_bimorph", "drive.csv"])
    assert caught.value.code == 3
    assert "2,000 samples of 1 ms need about" in capsys.readouterr().err


def test_a_text_of_many_blocks_is_the_text_of_one(monkeypatch):
    time_s, rows = np.arange(25) / 7.0, np.arange(50.0).reshape(2, 25) / 3.0
    groups, told = [("drive", "v", ("x", "y"), rows)], []
    whole = drive_csv(time_s, groups, ["To be sent."])
    monkeypatch.setattr("hammerstein.compensators.path_file.ROWS_AT_ONCE", 10)
    assert drive_csv(time_s, groups, ["To be sent."], told.append) == whole
    assert told == [f"writing {n} of 25 rows" for n in (10, 20, 25)]


class _SlowLaw(NoCompensation):
    """Plays what it is told, and takes 0.1 ms a sample."""

    law: Literal["slow"] = "slow"
    factor: float = 1.0

    def design(self, model, range_v, sample_time_s):
        law = super().design(model, range_v, sample_time_s)
        quick = law.respond

        def respond(reference_um, start=None):
            time.sleep(1e-4 * np.shape(reference_um)[1])
            return quick(reference_um, start)

        law.respond = respond
        return law


def test_a_law_that_plugs_in_counts_as_what_it_takes(monkeypatch):
    register(_SlowLaw)
    try:
        scenario = _scenario("slow", measure={"measured_cycles": 500})
        plant, (signal,) = plant_of(scenario), scenario.signals()
        seconds = 2 * 1e-4 * Window.of(scenario, signal, plant.sample_time_s).total  # two axes
        assert seconds < plan_of(scenario).seconds < 2.0 * seconds
        with monkeypatch.context() as counted:  # one trial for all runs of a study, and none to run
            counted.setattr("hammerstein.experiment.plan._trial_of", None)
            assert plan_of(scenario.model_copy(update={"seed": 5})).seconds < 2.0 * seconds
            assert plan_of(_scenario("slow", {"factor": 2.0}), timed=False).bytes > 0.0
    finally:
        COMPENSATORS.remove(_SlowLaw)
