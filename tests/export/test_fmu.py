"""The units of FMI 2.0 and 3.0: validated and simulated by FMPy, equal to Python to the last bit."""

import shutil
import zipfile

import numpy as np
import pytest
from export_cases import T, case

from hammerstein.commands.cli import main
from hammerstein.experiment.run import simulate
from hammerstein.export.folder import check_export, write_export
from hammerstein.export.trial import compiler
from hammerstein.model import HammersteinModel

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
pytestmark = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


@pytest.fixture(
    scope="module", params=["exact_inverse", pytest.param("filtered", marks=pytest.mark.full), "model"]
)
def unit(request, tmp_path_factory):
    export, folder = case(request.param), tmp_path_factory.mktemp("fmu")
    write_export(export.request(form="fmu"), export.model, folder)
    return export.code(form="fmu"), next(folder.glob("*.fmu"))


class Instance:
    """An instance of a unit, ready to step."""

    def __init__(self, path, folder, name="one"):
        from fmpy import extract
        from fmpy.fmi3 import FMU3Slave

        self.about = fmpy.read_model_description(str(path), validate=True)
        if not (folder / "modelDescription.xml").exists():  # a library in use must not be replaced
            extract(str(path), unzipdir=str(folder))
        self.unit = FMU3Slave(
            guid=self.about.guid, unzipDirectory=str(folder), instanceName=name,
            modelIdentifier=self.about.coSimulation.modelIdentifier,
        )  # fmt: skip
        self.log = []
        self.unit.instantiate(logMessage=lambda *told: self.log.append(told[-1].decode()))
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()
        names = {kind: [v.valueReference for v in self.about.modelVariables if v.causality == kind]
                 for kind in ("input", "output")}  # fmt: skip
        self.into, self.out = names["input"], names["output"]

    def step(self, values, now=0.0, step=T):
        self.unit.setFloat64(self.into, list(values))
        self.unit.doStep(currentCommunicationPoint=now, communicationStepSize=step)
        return np.array(self.unit.getFloat64(self.out))


def test_the_unit_is_valid(unit):
    code, path = unit
    about = fmpy.read_model_description(str(path), validate=True)
    assert about.fmiVersion == "3.0"
    assert {v.name[-2:]: v.unit for v in about.modelVariables[1:]} == {"um": "um", "_v": "V"}
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    assert {f"sources/{code.name}.c", "sources/fmu.c", "sources/buildDescription.xml"} <= set(names)


def test_every_bit_is_that_of_python(unit, tmp_path):
    code, path = unit
    signal = code.adverse(2000)
    instance = Instance(path, tmp_path)
    found = np.stack([instance.step(row, k * T) for k, row in enumerate(signal.T)], axis=1)
    assert (found.view(np.int64) == code.block.respond(signal)[0].view(np.int64)).all()


def test_a_longer_step_takes_samples_with_the_input_held(unit, tmp_path):
    code, path = unit
    signal = code.adverse(300)
    instance = Instance(path, tmp_path)
    found = np.stack([instance.step(row, 3 * k * T, 3 * T) for k, row in enumerate(signal.T)], axis=1)
    assert (found == code.block.respond(np.repeat(signal, 3, axis=1))[0][:, 2::3]).all()


@pytest.mark.parametrize("step", [0.5 * T, 1.5 * T, 0.0, -T, 2.01 * T, np.nan])
def test_any_other_step_is_refused(unit, tmp_path, step):
    code, path = unit
    signal = code.adverse(20)
    instance = Instance(path, tmp_path)
    with pytest.raises(Exception, match="fmi3DoStep"):
        instance.step(signal[:, 1], 0.0, step)
    assert instance.log == ["the communication step is no multiple of 50 us"]
    found = instance.step(signal[:, 2])
    assert (found == code.block.respond(signal[:, 2:3])[0][:, 0]).all()


def test_several_instances_do_not_know_each_other(unit, tmp_path):
    code, path = unit
    one, other = Instance(path, tmp_path / "a", "one"), Instance(path, tmp_path / "a", "other")
    signal = code.adverse(200)
    found, others = [], []
    for row in signal.T:
        found.append(one.step(row))
        others.append(other.step(-row if code.is_model else 0.5 * row))
    assert (np.stack(found, axis=1) == code.block.respond(signal)[0]).all()
    moved = -signal if code.is_model else 0.5 * signal
    assert (np.stack(others, axis=1) == code.block.respond(moved)[0]).all()


def test_states_are_kept_restored_and_serialised(unit, tmp_path):
    code, path = unit
    signal = code.adverse(400)
    instance = Instance(path, tmp_path)
    for row in signal[:, :200].T:
        instance.step(row)
    state = instance.unit.getFMUState()
    kept = instance.unit.serializeFMUState(state)
    ahead = [instance.step(row) for row in signal[:, 200:].T]
    instance.unit.setFMUState(state)
    assert (np.array([instance.step(row) for row in signal[:, 200:].T]) == np.array(ahead)).all()
    fresh = Instance(path, tmp_path)
    fresh.unit.setFMUState(fresh.unit.deserializeFMUState(kept))
    assert (np.array([fresh.step(row) for row in signal[:, 200:].T]) == np.array(ahead)).all()


def test_a_number_that_is_none_is_an_error(unit, tmp_path):
    code, path = unit
    instance = Instance(path, tmp_path)
    with pytest.raises(Exception, match="fmi3DoStep"):
        instance.step(np.full(code.shape.entering, np.nan))
    assert instance.log == ["an input is not finite or too large"]


def test_fmpy_simulates_it(unit):
    code, path = unit
    signal = code.adverse(100)
    names = [v.name for v in fmpy.read_model_description(str(path)).modelVariables if v.causality == "input"]
    rows = [(k * T, *column) for k, column in enumerate(signal.T)]
    table = np.array(rows, dtype=[("time", "f8"), *((name, "f8") for name in names)])
    result = fmpy.simulate_fmu(str(path), stop_time=99 * T, step_size=T, output_interval=T, input=table)
    assert len(result) == 100
    assert all(np.isfinite(result[name]).all() for name in result.dtype.names)


def test_the_command_writes_a_unit_and_checks_it(tmp_path, capsys):
    out = tmp_path / "unit"
    with pytest.raises(SystemExit) as caught:
        main(["export", "duo_bimorph", "--law", "none", "--fmi", "3", "--out", str(out)])  # an FMU
    assert not caught.value.code
    assert (out / "duo_bimorph_none.fmu").is_file()
    assert "duo_bimorph_none.fmu" in capsys.readouterr().out
    assert "fmu.c" in check_export(out)
    shutil.rmtree(out)


@pytest.fixture(scope="module", params=["exact_inverse", "model"])
def older(request, tmp_path_factory):
    export, folder = case(request.param), tmp_path_factory.mktemp("fmi2")
    write_export(export.request(form="fmu", fmi=2), export.model, folder)
    return export.code(form="fmu", fmi=2), next(folder.glob("*.fmu"))


def _second(path, folder, told):
    """An instance of a unit of FMI 2.0, ready to step, and its value references; it logs to ``told``."""
    from fmpy import extract
    from fmpy.fmi2 import FMU2Slave, defaultCallbacks, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

    about = fmpy.read_model_description(str(path), validate=True)
    assert about.fmiVersion == "2.0"
    extract(str(path), unzipdir=str(folder))
    found = FMU2Slave(
        guid=about.guid, unzipDirectory=str(folder), instanceName="one",
        modelIdentifier=about.coSimulation.modelIdentifier,
    )  # fmt: skip
    listener = fmi2CallbackLoggerTYPE(lambda *words: told.append(words[-1].decode()))
    others = (getattr(defaultCallbacks, name) for name, _ in fmi2CallbackFunctions._fields_[1:])
    found.instantiate(callbacks=fmi2CallbackFunctions(listener, *others))
    found.setupExperiment()
    found.enterInitializationMode()
    found.exitInitializationMode()
    names = [
        [v.valueReference for v in about.modelVariables if v.causality == kind]
        for kind in ("input", "output")
    ]
    return found, *names


@pytest.mark.full
def test_every_bit_of_fmi_2_is_that_of_python(older, tmp_path):
    """Steps, and the same steps again from a state that was kept and serialised."""
    code, path = older
    signal, told = code.adverse(600), []
    unit, into, out = _second(path, tmp_path, told)
    expected, _ = code.block.respond(signal)

    def step(k):
        unit.setReal(into, list(signal[:, k]))
        unit.doStep(currentCommunicationPoint=k * T, communicationStepSize=T)
        return np.array(unit.getReal(out))

    found = np.stack([step(k) for k in range(300)], axis=1)
    kept = unit.serializeFMUState(unit.getFMUState())
    later = np.stack([step(k) for k in range(300, 600)], axis=1)
    assert (np.hstack([found, later]).view(np.int64) == expected.view(np.int64)).all()
    unit.setFMUState(unit.deSerializeFMUstate(kept))
    assert (np.stack([step(k) for k in range(300, 600)], axis=1) == later).all()
    with pytest.raises(Exception, match="fmi2DoStep"):
        unit.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.5 * T)
    assert told == ["the communication step is no multiple of 50 us"]
    unit.terminate()
    unit.freeInstance()


@pytest.mark.full
def test_fmpy_simulates_fmi_2_as_fmi_3(older, tmp_path):
    code, path = older
    export = case("model" if code.is_model else "exact_inverse")
    write_export(export.request(form="fmu"), export.model, tmp_path / "three")
    newer = next((tmp_path / "three").glob("*.fmu"))
    signal = code.adverse(100)
    names = [v.name for v in fmpy.read_model_description(str(path)).modelVariables if v.causality == "input"]
    rows = [(k * T, *column) for k, column in enumerate(signal.T)]
    table = np.array(rows, dtype=[("time", "f8"), *((name, "f8") for name in names)])
    one, other = (
        fmpy.simulate_fmu(str(place), stop_time=99 * T, step_size=T, output_interval=T, input=table)
        for place in (path, newer)
    )
    assert len(one) == 100
    assert all((one[name] == other[name]).all() for name in one.dtype.names if name != "time")


def _played(path, names, values):
    """Outputs of a unit (axis, sample), simulated by FMPy over inputs; row 0 of it stands before them."""
    samples = values.shape[1]
    rows = [(k * T, *column) for k, column in enumerate(values.T)]
    table = np.array(rows, dtype=[("time", "f8"), *((name, "f8") for name in names)])
    result = fmpy.simulate_fmu(str(path), stop_time=samples * T, step_size=T, output_interval=T, input=table)
    return np.stack([result[name] for name in result.dtype.names[1:]])[:, 1 : samples + 1]


@pytest.mark.full
def test_a_scenario_runs_on_two_units(tmp_path):
    """Law and actuator as units behind each other follow the scenario's reference as the scenario does."""
    compensators = [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph"}]
    response = simulate(
        {
            "question": "Does the unit follow?",
            "actuator": "duo_bimorph",
            "reference": {"kind": "circle", "radius_um": 20.0, "frequency_hz": 80.0},
            "measure": {"settle_s": 0.0, "settle_cycles": 1, "measured_cycles": 1},
            "compensators": compensators,
        }
    )
    limits = HammersteinModel.load("duo_bimorph").instruments.drive.limits(2)
    places = {}
    for name in ("exact_inverse", "model"):
        export = case(name)
        request = export.request(form="fmu", range_v=(float(limits[0, 0]), float(limits[1, 0])))
        write_export(request, export.model, tmp_path / name)
        places[name] = next((tmp_path / name).glob("*.fmu"))
    drive_v = _played(places["exact_inverse"], ["reference_x_um", "reference_y_um"], response.reference_um)
    assert (drive_v.view(np.int64) == response.requested_v.view(np.int64)).all()
    position_um = _played(places["model"], ["drive_x_v", "drive_y_v"], response.drive_v)
    np.testing.assert_allclose(position_um, response.position_um, rtol=0.0, atol=1e-9)
    error = np.abs(position_um - response.reference_um)[:, 250:].max()
    assert error == pytest.approx(np.abs(response.position_um - response.reference_um)[:, 250:].max())
