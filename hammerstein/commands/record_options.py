"""What a person says of records and of how they are identified: options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Files = Annotated[list[Path], typer.Argument(metavar="FILE", help="Records: CSV, .dat, .npy, .mat, Parquet.")]
Inputs = Annotated[str, typer.Option(metavar="COL[,COL]", help="Voltage columns, by name or number from 1.")]
Outputs = Annotated[
    str, typer.Option(metavar="COL[,COL]", help="Displacement columns, by name or number from 1.")
]
Rate = Annotated[float | None, typer.Option(metavar="HZ", help="Samples a second.")]
Time = Annotated[str | None, typer.Option(metavar="COL", help="Time column in s, instead of --rate.")]
InputScale = Annotated[
    float | None,
    typer.Option(metavar="S", help="Factor from the file's number to V; from its unit if not given."),
]
OutputScale = Annotated[
    float | None,
    typer.Option(metavar="S", help="Factor from the file's number to um; from its unit if not given."),
]
AcceptGain = Annotated[
    bool, typer.Option("--accept-gain", help="Take a gain outside 0.001 to 1000 um/V as it is.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]

Validate = Annotated[
    list[Path] | None, typer.Option(metavar="FILE", help="Records held back; may be repeated.")
]
Operators = Annotated[
    str, typer.Option(help="Thresholds of each pair; auto: as many as the records call for.")
]
Placing = Annotated[
    str,
    typer.Option(
        help="Thresholds: uniform in time or voltage, fitted to the records, or auto: fitted if it pays."
    ),
]
Thresholds = Annotated[
    str | None, typer.Option(metavar="V[,V]", help="Thresholds in V for all pairs, instead of these.")
]
Weights = Annotated[str, typer.Option(help="invertible, least_squares, nonnegative or closed_form.")]
Ridge = Annotated[float, typer.Option(help="Penalty of the weights; 0: none.")]
DynamicsOption = Annotated[
    str, typer.Option(help="none, lag, second_order, state_space, or auto: what lowers the error.")
]
Order = Annotated[
    int | None,
    typer.Option(help="Order of a state-space model; found if not given."),
]
CreepModes = Annotated[str, typer.Option(help="Slow modes of each axis; auto: one if it lowers the error.")]
DelaySamples = Annotated[int | None, typer.Option(help="Delay of the outputs; found if not given.")]
SensorBandwidth = Annotated[
    float | None, typer.Option(metavar="HZ", help="Of the sensor, from its data sheet.")
]
