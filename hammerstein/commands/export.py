"""The command that turns a model into code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hammerstein.commands.law_options import LawWords, Sent
from hammerstein.commands.options import grouped
from hammerstein.commands.record_options import Overwrite
from hammerstein.commands.terminal import tell, tell_json, tell_kept, tell_statements

FORMATS = ("c", "fmu")


@grouped
def export(
    *,
    model: Annotated[str | None, typer.Argument(help="Model file, or packaged actuator.")] = None,
    law: Annotated[
        str, typer.Option(help="A law of compensate, or model: the actuator itself.")
    ] = "exact_inverse",
    form: Annotated[str, typer.Option("--format", help="c: C99; fmu: the same C code as an FMU.")] = "c",
    fmi: Annotated[int, typer.Option(metavar="2|3", help="FMI version of the FMU: 2 or 3.")] = 3,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the code.")] = None,
    check: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Repeat an export and compare the files.")
    ] = None,
    sample_time: Annotated[
        float | None, typer.Option(metavar="S", help="Sample time; default: that of the model's drive.")
    ] = None,
    words: LawWords,
    sent: Sent,
    float32: Annotated[bool, typer.Option("--float32", help="Compute in single precision.")] = False,
    overwrite: Overwrite = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Export a law or a model as C code or as an FMU.

    The code runs without Python.
    """
    from hammerstein.commands.options import told_by_options
    from hammerstein.errors import InputError
    from hammerstein.export.folder import ALWAYS, EXPORT, check_export, write_export
    from hammerstein.export.request import request_of
    from hammerstein.runtime.staging import prepare_folder

    if check is not None and model is None:
        files = check_export(check)
        if as_json:
            tell_json({"check": str(check), "files": files})
        else:
            tell(f"{check}: all {len(files)} files match the model")
        return
    if check is not None or model is None:
        raise InputError("export", "give a model and --out DIR, or only --check DIR")
    if form not in FORMATS:
        raise InputError("--format", f"{form!r} is not one of {', '.join(FORMATS)}")
    if fmi not in (2, 3):
        raise InputError("--fmi", f"{fmi} is not one of 2, 3")
    if out is None:
        raise InputError("--out", "name a folder for the code")
    with told_by_options("compensate", words.own):
        prepare_folder("--out", out, EXPORT, ALWAYS, overwrite)
        request, loaded = request_of(
            model,
            law,
            sample_time,
            fmi=fmi,
            options=words.options(),
            range_v=sent.ends,
            start_v=sent.begins,
            conditioned=sent.conditioned,
            accept_flagged=sent.accept_flagged,
            float32=float32,
            form=form,
        )
        written = write_export(request, loaded, out, overwrite)
    tell_kept(written.kept)
    if as_json:
        tell_json({"export": str(out), "statements": written.statements, "files": written.files})
        return
    tell_statements(written.statements)
    tell(f"{', '.join(written.files)} in {out}; run make check there to replay golden.csv")
