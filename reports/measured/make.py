"""Identify the actuators of three public sets of measured records, and write the results beside this file.

    python reports/measured/make.py FOLDER [fits | comparisons]

Without a second word both pages are written. FOLDER holds the sets, each in a folder of its own:
`dbo_piezo_micromanipulator`, `cubespec_fsm` and
`ja_magnetic_loops`. README.md says where they come from.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from hammerstein.comparison.compare import compare
from hammerstein.comparison.fitting import LINEAR, WITH_DYNAMICS
from hammerstein.comparison.result import Comparison
from hammerstein.identification.fit import Fit
from hammerstein.identification.identify import identify
from hammerstein.identification.options import identifiable_kinds
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.records.reading import read_paired_records, read_records
from hammerstein.records.record import Record
from hammerstein.reporting.compare_page import write_comparison
from hammerstein.reporting.fit_page import write_fit

HERE = Path(__file__).parent
NOTES = """# Measured records

Models that `hammerstein` identifies from public records of real actuators and magnets. The models have
15 play operators unless the table says otherwise. `python reports/measured/make.py FOLDER` writes this
page and the fit reports; the records themselves are not in this repository:

* **micromanipulator**: piezo stage with a flexure and a capacitive sensor, 1 Hz sine, sampled at 200 Hz.
  Aye, github.com/yan9a/DiscreteBacklashOperator (MIT).
* **mirror**: fine steering mirror, 3 x 3, random-phase multisines, sampled at 6400 Hz. Floren et al.,
  github.com/merijnfloren/fsm-benchmark-data (CC BY 4.0).
* **ferrite, steel, amorphous**: quasi-static magnetic loops. The magnetic field takes the place of the
  voltage, and the flux density that of the displacement, so only the percentages have a meaning.
  Szewczyk, github.com/romanszewczyk/JAmodel (MIT).

Errors are rms values in percent of the range of the output; for the mirror also in percent of the rms of
the output (mean of the three outputs). The fit has not seen the validation records. *Wanted* is the goal
of this project, which the tests check if the records are at hand. [Another page](compared/README.md)
compares all kinds of hysteresis and the linear models on the same records.

| record | model | fitted [%] | validation [%] | wanted [%] | statement of the tool |
| --- | --- | ---: | ---: | --- | --- |
"""
COMPARED = """# Every kind on measured records

Result of `hammerstein compare` on the [same records](../README.md). For each kind of hysteresis the
table shows the better one of its models, with or without a linear block: its rms error in percent of the
range, on the validation record if there is one, else on the fitted loop. The recommended kind has the
lowest cross-validation error, or is simpler and as good, so it does not always have the lowest error in
the table. A kind without a number could not be fitted: a single rate does not identify how thresholds
grow, and static Bouc-Wen and envelope searches diverge on the mirror, whose motion is dynamic. `compare`
is given the records alone, for the magnets also that they have no dynamics, and for the mirror also that
it needs a state space of order 28. Only plays can stand in front of a state space; the mark *alone*
means without one. `python reports/measured/make.py FOLDER comparisons` writes this page.

| record | judged on | recommended | {kinds} |
| --- | --- | --- | {dashes} |
"""
STATIC: dict[str, Any] = {"operators": 15, "partition": "time", "dynamics": "none", "creep_modes": 0}
MAGNETS = (
    ("11_TwoStepSolver_{}_MnZn_HP_ferrite.mat", "ferrite, high permeability"),
    ("12_Automation2018_{}_MnZn_ferrite.mat", "ferrite, 2018"),
    ("1_isotropic_{}_MnZn_ferrite.mat", "ferrite, isotropic"),
    ("2_anisotropic_{}_amorf.mat", "amorphous"),
    ("10_APPA_{}_M130_27s.mat", "steel, grain-oriented"),
)


def stage_records(file: Path) -> tuple[Record, ...]:
    """Records of the micromanipulator, called by the name of their file alone."""
    return named(read_records([file], inputs=["1"], outputs=["5"], rate_hz=200.0))


def micromanipulator(folder: Path) -> Iterator[str]:
    """One axis, with and without delay, and with the closed form."""
    records, held = (stage_records(folder / name) for name in ("Model_Vi_Do.dat", "Test_Vi_Do_Di.dat"))
    cases: tuple[tuple[str, str, str, dict[str, Any]], ...] = (
        ("micromanipulator", "`invertible`, delay estimated", "0.85, validation 1.2", {}),
        ("", "`invertible`, no delay", "0.85, validation 1.4", {"delay_samples": 0}),
        ("", "`closed_form` (paper), delay estimated", "validation 1.4", {"solver": "closed_form"}),
    )
    for name, what, wanted, options in cases:
        model, fit = identify(
            records, Settings(**(STATIC | options)), validation=held, name="micromanipulator"
        )
        delay = f"delay of {fit.delay_samples:g} sample; " if fit.delay_samples else ""
        errors = (fit.fit, fit.validation)
        cells = [f"{scores[fit.kind].nrmse_percent[0]:.3f}" for scores in errors]
        linear = f"linear gain {fit.validation['linear'].nrmse_percent[0]:.2f}"
        yield row(link(model, fit, name), what, *cells, wanted, f"{delay}{linear}, validation")


MIRROR: dict[str, Any] = {
    "dynamics": "state_space",
    "order": 28,
    "operators": 2,
    "partition": "time",
    "creep_modes": 0,
    "error_curve": False,
}


MIRROR_MV = (100, 200, 300)


def mirror_records(folder: Path, level: int, part: str) -> tuple[Record, ...]:
    """Records of the mirror at an amplitude [mV]."""
    files = [folder / f"{axis}_{level}mV_{part}.npy" for axis in "uy"]
    axes = ("sample", "channel", "experiment", "period")
    return read_paired_records(*files, axes=axes, rate_hz=6400.0, output_scale=1e6)


def mirror(folder: Path) -> Iterator[str]:
    """Three axes at three amplitudes, linear dynamics and hysteresis beside each other."""
    settings = Settings(**MIRROR)
    for level, most in zip(MIRROR_MV, (8.4, 8.0, 5.6), strict=True):
        model, fit = identify(
            mirror_records(folder, level, "train"),
            settings,
            validation=mirror_records(folder, level, "test"),
            name=f"mirror at {level} mV",
        )
        cells = []
        for scores in (fit.fit, fit.validation):
            score = scores["linear_dynamics"]
            relative = sum(score.output_percent) / len(score.output_percent)
            cells.append(f"{score.mean_percent:.3f} ({relative:.2f} of rms)")
        said = fit.verdict.split(" of the range. ")[1].split(":")[0]
        name = link(model, fit, f"mirror_{level}mV")
        yield row(name, "linear dynamics of order 28", *cells, f"{most} of rms", said)


def magnets(folder: Path) -> Iterator[str]:
    """Each loop alone, from the smallest field to saturation."""
    for pattern, name in MAGNETS:
        field, flux = (folder / pattern.format(quantity) for quantity in "HB")
        records = read_paired_records(field, flux, axes=("sample", "experiment"), rate_hz=100.0)
        for record in sorted(records, key=lambda r: float(r.u_v.max())):
            _, fit = identify([record], Settings(**STATIC, error_curve=False))
            percent = fit.fit["static_hysteresis"].nrmse_percent[0]
            loop = f"{name}, up to {record.u_v.max():.3g} A/m"
            wanted = "to be flagged" if fit.flags else "0.25" if "steel" not in name else ""
            yield row(loop, "Prandtl-Ishlinskii", f"{percent:.3f}", "", wanted, said_of(fit))
            if fit.flags:
                yield beyond_plays(record, percent)


def beyond_plays(record: Record, plays_percent: float) -> str:
    """Line of a loop with plays and dead-zones, identified with default settings."""
    _, fit = identify([record], Settings(hysteresis="asymmetric"))
    percent = fit.fit[fit.kind].nrmse_percent[0]
    wanted = f"{plays_percent / 3.0:.3f}"
    return row("", "`asymmetric`, default settings", f"{percent:.3f}", "", wanted, said_of(fit))


def said_of(fit: Fit) -> str:
    """The flags of a loop in a few words."""
    found = [re.search(r"saturates|drifts|is missed by \S+ %", flag) for flag in fit.flags]
    return "; ".join(match.group() for match in found if match) or "no flag"


def comparisons(folder: Path) -> Iterator[str]:
    """A line a record: the error of every kind."""
    stage = folder / "dbo_piezo_micromanipulator"
    records, held = (stage_records(stage / name) for name in ("Model_Vi_Do.dat", "Test_Vi_Do_Di.dat"))
    found = compare(records, Settings(), validation=held)
    page = HERE / "compared" / "micromanipulator"
    write_comparison(found, page, overwrite=True)
    for entry in found.entries:
        (page / entry.file).unlink()
    yield compared("[micromanipulator](micromanipulator/compare.md)", found)
    for level in MIRROR_MV:
        mirror = folder / "cubespec_fsm"
        records, held = (named(mirror_records(mirror, level, part)) for part in ("train", "test"))
        yield compared(f"mirror, {level} mV", compare(records, Settings(**MIRROR), validation=held))
    for pattern, name in MAGNETS:
        field, flux = (folder / "ja_magnetic_loops" / pattern.format(quantity) for quantity in "HB")
        records = named(read_paired_records(field, flux, axes=("sample", "experiment"), rate_hz=100.0))
        for record in sorted(records, key=lambda r: float(r.u_v.max())):
            found = compare([record], Settings(dynamics="none", creep_modes=0, error_curve=False))
            yield compared(f"{name}, up to {record.u_v.max():.3g} A/m", found)


def named(records: Sequence[Record]) -> tuple[Record, ...]:
    """The records with the names of their files instead of paths."""
    return tuple(replace(r, source=PurePath(r.source).name, verified=True) for r in records)


def compared(name: str, found: Comparison) -> str:
    """Line of one record; a kind without the requested linear block is marked."""
    errors = []
    alone = {one.hysteresis for one in found.failed if one.name.endswith(WITH_DYNAMICS)}
    for kind in (LINEAR, *identifiable_kinds()):
        own = [entry.judged.mean_percent for entry in found.entries if entry.hysteresis == kind]
        errors.append(f"{min(own):.3f}{' alone' * (kind in alone)}" if own else "")
    return row(name, "validation record" if found.validation else "fitted loop", found.recommended, *errors)


def link(model: HammersteinModel, fit: Fit, name: str) -> str:
    """Write the fit report of a named case, and give a link to it."""
    if not name:
        return ""
    with tempfile.TemporaryDirectory() as scratch:
        write_fit(model, fit, Path(scratch) / "model.json", HERE / name, overwrite=True)
    return f"[{name.replace('_', ', ')}]({name}/report.md)"


def row(*cells: str) -> str:
    """One line of the table."""
    return f"| {' | '.join(cells)} |"


def main(folder: Path, pages: Sequence[str]) -> None:
    """Write the pages."""
    if "fits" in pages:
        lines = [
            *micromanipulator(folder / "dbo_piezo_micromanipulator"),
            *mirror(folder / "cubespec_fsm"),
            *magnets(folder / "ja_magnetic_loops"),
        ]
        (HERE / "README.md").write_text(NOTES + "\n".join(lines) + "\n", encoding="utf-8")
    if "comparisons" in pages:
        names = ("linear", *identifiable_kinds())
        head = COMPARED.format(kinds=" | ".join(names), dashes=" | ".join(["---:"] * len(names)))
        lines = list(comparisons(folder))
        page = HERE / "compared" / "README.md"
        page.parent.mkdir(exist_ok=True)
        page.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


PAGES = ("fits", "comparisons")

if __name__ == "__main__":
    if len(sys.argv) not in (2, 3) or not {*sys.argv[2:]} <= {*PAGES}:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), sys.argv[2:] or PAGES)
