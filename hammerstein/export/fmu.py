"""The same C as a unit of FMI 2.0 or 3.0 for co-simulation.

Source: Modelica Association, Functional Mock-up Interface 2.0 (2014) and 3.0 (2022), sections 2 and 4.
"""

from __future__ import annotations

import hashlib
import io
import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hammerstein.errors import InputError
from hammerstein.export.code import rendered
from hammerstein.export.compiling import FLAGS, build, compiler
from hammerstein.export.literals import literal

DESCRIPTION, BUILD, UNIT = "modelDescription.xml", "buildDescription.xml", "fmu.c"
FIRST_IN = 1  # value references count from 1; 0 is the time
_EARLIEST = (1980, 1, 1, 0, 0, 0)  # no clock: two exports give the same bytes
_SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
_PROCESSORS = {"AMD64": "x86_64", "arm64": "aarch64"}
_OLDER = {"linux": "linux", "darwin": "darwin", "windows": "win"}


def unit_files(version: int, context: Mapping[str, Any]) -> dict[str, str]:
    """Text of what a unit of FMI 2.0 or 3.0 has beside the law."""
    templates = {UNIT: f"fmi{version}.c.jinja", DESCRIPTION: f"fmi{version}.xml.jinja"}
    templates |= {BUILD: f"{BUILD}.jinja"} if version == 3 else {}
    return {name: rendered(template, **context) for name, template in templates.items()}


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
