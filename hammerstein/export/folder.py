"""Folder of an export: code, self-test, model and request, and the same code as an FMU for co-simulation.

Source: Modelica Association, Functional Mock-up Interface 2.0 (2014) and 3.0 (2022), sections 2 and 4.
"""

import hashlib
import io
import json
import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import model_validator

from hammerstein.arrays import Array
from hammerstein.errors import InputError, ToleranceError
from hammerstein.export.code import CCode, MeasuredCode, rendered
from hammerstein.export.literals import literal
from hammerstein.export.request import Request
from hammerstein.export.trial import FLAGS, SAMPLES, WAVES, build, compiler, entering, worst_case_step
from hammerstein.files import read_limited
from hammerstein.model import HammersteinModel
from hammerstein.quantities import column
from hammerstein.runtime.staging import Owner, staged
from hammerstein.validation import Strict, mistakes_in

DESCRIPTION, BUILD, UNIT = "modelDescription.xml", "buildDescription.xml", "fmu.c"
FIRST_IN = 1  # value references count from 1; 0 is the time
_EARLIEST = (1980, 1, 1, 0, 0, 0)  # no clock: two exports give the same bytes
_SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
_PROCESSORS = {"AMD64": "x86_64", "arm64": "aarch64"}
_OLDER = {"linux": "linux", "darwin": "darwin", "windows": "win"}


def fmu_context(sources: str, sample_time_s: float, n_entering: int, columns: list[str]) -> dict[str, Any]:
    """Names that the templates of a unit ask for besides those of the law.

    sources : text of the law, whose digest tells units apart; columns : names of inputs, then outputs
    """
    return {
        "token": hashlib.sha256(sources.encode()).hexdigest()[:32],
        "sample_time_s": literal(sample_time_s),
        "first_in": FIRST_IN,
        "first_out": FIRST_IN + n_entering,
        "fmu_inputs": columns[:n_entering],
        "fmu_outputs": columns[n_entering:],
    }


def fmu_of(name: str, files: Mapping[str, str], version: int) -> bytes:
    """Archive of a unit, compiled for this machine, sources inside.

    Parameters
    ----------
    name : of the law
    files : those of the export
    version : of FMI, 2 or 3

    Raises InputError where there is no C compiler.
    """
    if compiler() is None:
        raise InputError("--format fmu", "needs a C compiler to build the unit; install one, or set CC")
    system, ending = _SYSTEMS.get(sys.platform, ("linux", ".so"))
    machine = _PROCESSORS.get(platform.machine(), platform.machine())
    sources = {
        f"sources/{part}": files[part] for part in (f"{name}.h", f"{name}.c", UNIT, BUILD) if part in files
    }
    content: dict[str, str | bytes] = {DESCRIPTION: files[DESCRIPTION], **sources}
    content["documentation/README.md"] = files["README.md"]
    bits = 64 if sys.maxsize > 2**32 else 32
    binaries = f"{machine}-{system}" if version == 3 else f"{_OLDER[system]}{bits}"
    content[f"binaries/{binaries}/{name}{ending}"] = _compiled(name, files, ending)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for place, data in content.items():
            packed.writestr(zipfile.ZipInfo(place, _EARLIEST), data, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _compiled(name: str, files: Mapping[str, str], ending: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="hammerstein-") as folder:
        for part in (f"{name}.h", f"{name}.c", UNIT):
            (Path(folder) / part).write_text(files[part], encoding="utf-8")
        out = Path(folder) / f"{name}{ending}"
        sources = [str(Path(folder) / part) for part in (f"{name}.c", UNIT)]
        hidden = ("-fPIC", "-fvisibility=hidden")
        build([*hidden, "-shared", *sources, "-o", str(out)], FLAGS)
        return out.read_bytes()


MODEL_FILE, REQUEST_FILE = "model.json", "export.json"
EXPORT = Owner("export")
ALWAYS = (REQUEST_FILE, MODEL_FILE, "README.md", "Makefile", "golden.csv", "selftest.c")
SEARCHED = 100_000
"""Samples of a drive that seeks the largest number of operations."""


class ExportFile(Strict):
    """Request of an export, and its measured figures."""

    request: Request
    measured: MeasuredCode

    @model_validator(mode="after")
    def _loses_as_it_says(self) -> Self:
        if self.request.float32 == (self.measured.loss_rms is None or self.measured.loss_max is None):
            raise ValueError("measured has loss_rms and loss_max if request.float32 is true, else neither")
        return self


def files_of(code: CCode, measured: MeasuredCode | None = None) -> dict[str, str]:
    """Every file of an export, by its name.

    Parameters
    ----------
    code : what is exported
    measured : figures of an earlier export; measured now, where there is a C compiler, if not given

    Raises
    ------
    InputError : there is no C code for it, or single precision without a C compiler
    """
    request, model = code.request, code.model
    signal = entering(code.block, code.model_on_grid, SAMPLES)
    output = code.block.respond(signal)[0]
    found = measured if measured is not None else measure(code, signal, output)
    if request.float32:  # the numbers that its own code gives: a tolerance of its loss would notice nothing
        with code.library() as library:
            output = library.respond(signal)[0].astype(np.float64)
    context = code.context() | {
        "request": request,
        "model_name": model.name,
        "statements": code.statements(),
        "cost": code.cost,
        "measured": found,
        "rows": signal.shape[1],
        "columns": _columns(code),
        "file_name": code.name,
    }
    header, source = code.header(), code.source(found)
    export = ExportFile(request=request, measured=found).model_dump(mode="json", exclude_none=True)
    unit: dict[str, str] = {}
    if request.form == "fmu":
        context |= fmu_context(header + source, request.sample_time_s, code.shape.entering, _columns(code))
        templates = {UNIT: f"fmi{request.fmi}.c.jinja", DESCRIPTION: f"fmi{request.fmi}.xml.jinja"}
        templates |= {BUILD: f"{BUILD}.jinja"} if request.fmi == 3 else {}
        unit = {name: rendered(template, **context) for name, template in templates.items()}
    return unit | {
        f"{code.name}.h": header,
        f"{code.name}.c": source,
        "golden.csv": _golden(code, signal, output),
        "selftest.c": rendered("selftest.c.jinja", **context),
        "Makefile": rendered("Makefile.jinja", **context),
        "README.md": rendered("README.md.jinja", **context),
        MODEL_FILE: model.to_json(),
        REQUEST_FILE: json.dumps(export, indent=1, sort_keys=True) + "\n",
    }


def measure(code: CCode, signal: Array, output: Array) -> MeasuredCode:
    """Search for the most operations of a step, and find the loss of single precision.

    Raises InputError for single precision where there is no C compiler.
    """
    if compiler() is None:
        if code.request.float32:
            raise InputError(
                "--float32", "needs a C compiler to measure the loss of precision; install one, or set CC"
            )
        return MeasuredCode()
    with code.library(counting=True) as library:
        wild = code.adverse(SEARCHED)
        climbed, tried = worst_case_step(lambda made: library.respond(made)[1], np.abs(wild).max(axis=1))
        most = max(library.respond(wild)[1], climbed)
        smooth = signal[:, : SAMPLES // WAVES]
        lost = np.abs(library.respond(smooth)[0] - output[:, : SAMPLES // WAVES])
    loss = {}
    if code.request.float32:
        loss = {"loss_rms": float(np.sqrt(np.mean(lost**2))), "loss_max": float(lost.max())}
    return MeasuredCode(operations=most, samples=SEARCHED + tried, **loss)


class WrittenCode(NamedTuple):
    """Result of writing: names of the files, notes for a person, and files that were kept aside."""

    files: tuple[str, ...]
    statements: tuple[str, ...]
    kept: tuple[Path, ...]


def write_export(
    request: Request, model: HammersteinModel, folder: Path, overwrite: bool = False
) -> WrittenCode:
    """Write an export; all of its files, or none."""
    code = CCode(request, model, request.block(model))
    files = files_of(code)
    with staged(folder, EXPORT, overwrite) as stage:
        for name, content in files.items():
            stage.write(name, content)
        if request.form == "fmu":
            stage.write(f"{code.name}.fmu", fmu_of(code.name, files, request.fmi))
    written = (*files, f"{code.name}.fmu") if request.form == "fmu" else tuple(files)
    said = code.statements()
    if request.float32:
        said += code.precision(ExportFile.model_validate_json(files[REQUEST_FILE]).measured)
    return WrittenCode(written, tuple(said), stage.kept)


def check_export(folder: Path) -> list[str]:
    """Repeat an export from its own files; return their names.

    Raises
    ------
    InputError : the folder holds no export
    ToleranceError : a file differs from the new one
    """
    place = folder / REQUEST_FILE
    with mistakes_in(str(place), ExportFile):
        export = ExportFile.model_validate_json(read_limited(place, "file of an export"))
    model = HammersteinModel.load(folder / MODEL_FILE)
    files = files_of(CCode(export.request, model, export.request.block(model)), export.measured)
    differing = [said for name, text in files.items() if (said := _difference(folder / name, text))]
    if differing:
        raise ToleranceError(f"{folder}: differs from the export of its model\n" + "\n".join(differing))
    return sorted(files)


def _difference(path: Path, text: str) -> str:
    """Say in which line a file differs; empty if it does not."""
    if not path.is_file():
        return f"  {path.name} is missing"
    there = path.read_bytes().decode("utf-8", errors="replace").splitlines()
    if there == text.splitlines():
        return ""
    pairs = enumerate(zip_longest(there, text.splitlines()), start=1)
    first = next(n for n, (a, b) in pairs if a != b)
    return f"  {path.name} differs from line {first} on"


def _columns(code: CCode) -> list[str]:
    """Names of the columns of golden.csv."""
    model = code.model
    volts, places = [column("drive", name, "v") for name in model.inputs], model.outputs
    if code.is_model:
        return [*volts, *(column("position", name, "um") for name in places)]
    return [*(column("reference", name, "um") for name in places), *volts]


def _golden(code: CCode, signal: Array, output: Array) -> str:
    head = ",".join(_columns(code))
    rows = (",".join(map(repr, row)) for row in np.vstack([signal, output]).T.tolist())
    return "\n".join([head, *rows]) + "\n"
