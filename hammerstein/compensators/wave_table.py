"""Wave tables: one settled period in the format of an amplifier or a waveform generator.

Sources of formats and limits:

* Physik Instrumente, E-727 user manual E727T0005 (2019): a wave table is output point by point; one cycle
  lasts servo update time x table rate x points; the update time of the E-727 is 50 us. Points are loaded by
  the command ``WAV <table> X|& PNT``; the text here holds them, one column a table.
* piezosystem jena, ``nv200-python-lib`` (2025): the NV200's generator holds up to 1024 samples, each for a
  multiple of 50 us.

The tables were not tried on a device.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compensators.cycle import Cycle, held_error, held_least, number_unit
from hammerstein.errors import InputError
from hammerstein.escaping import clean
from hammerstein.metrics import rms
from hammerstein.quantities import column, interval
from hammerstein.runtime.staging import Owner

WAVE_TABLE = Owner("wave table", single=True)


class Device(NamedTuple):
    """Limits of a kind of table.

    most_points : that it holds, if its source says so; step_s : of which the time of a point is a multiple
    fixed_unit : whether its numbers are volts by themselves; digits : behind the point
    """

    what: str
    most_points: int | None
    step_s: float | None
    fixed_unit: bool
    digits: int


DEVICES = {
    "pi": Device("wave table of Physik Instrumente", None, 50e-6, False, 6),
    "nv200": Device("waveform of a piezosystem jena NV200", 1024, 50e-6, False, 4),
    "csv": Device("table for a waveform generator", None, None, True, 6),
}


@dataclass(frozen=True, eq=False)
class WaveTable:
    """Points (m, n) of a table in volts, each held over ``hold`` samples of the cycle.

    errors_um : rms error of the played path: of the cycle itself, held for the table, and as it is written
    """

    cycle: Cycle
    device: str
    hold: int
    volts: Array
    scale: tuple[float, float]
    errors_um: tuple[float, float, float]

    @property
    def points(self) -> int:
        """Number of points of a table."""
        return int(self.volts.shape[1])

    @property
    def point_s(self) -> float:
        """Duration of a point [s]."""
        return self.hold * self.cycle.sample_time_s

    def numbers(self) -> Array:
        """Numbers of the table (m, n)."""
        factor, offset = self.scale
        return np.asarray(np.round(factor * self.volts + offset, DEVICES[self.device].digits))

    def statements(self) -> list[str]:
        """Describe the table, the error that it adds, and open questions."""
        own, held, written = self.errors_um
        device = DEVICES[self.device]
        what = "Rms error added by the table" if self.cycle.learnt else "Rms error of the position"
        said = [
            f"{device.what[0].upper()}{device.what[1:]}: {self.points} points of {self.point_s:.6g} "
            f"s, one column for each input. Number in the table = {self.scale[0]:g} x V + "
            f"{self.scale[1]:g}.",
            f"{what}: {own:.4g} um with every sample, {held:.4g} um with points of "
            f"{self.point_s:.6g} s, {written:.4g} um as written."
            + (" The points were computed for the smallest second error." if self.hold > 1 else ""),
            *self.cycle.statements(),
            "This format was not tested on hardware: first compare its output with the prediction.",
        ]
        if self.device == "pi":
            rate = round(self.point_s / (device.step_s or 1.0))
            return [*said, f"Table rate {rate} at a servo update time of 50 us; it holds for all tables."]
        return said

    def text(self) -> str:
        """Text of the file."""
        said, numbers, header = self.statements(), self.numbers(), list[str]()
        if self.device == "csv":  # the header first and the notes last, as in a drive file
            unit = number_unit(*self.scale)
            header = [",".join(column("drive", name, unit) for name in self.cycle.model.inputs)]
            rate, low, high = 1.0 / self.point_s, numbers.min(), numbers.max()
            said.append(f"points {self.points}, rate {rate:.10g} Hz, low {low:g}, high {high:g}")
        lines = (f"# {clean(' '.join(words.split()))}" for words in said)
        separator, digits = "\t" if self.device == "pi" else ",", DEVICES[self.device].digits
        rows = (separator.join(f"{value:.{digits}f}" for value in row) for row in numbers.T)
        below = [*header, *rows, *lines] if header else [*lines, *rows]
        return "\n".join(below) + "\n"


def wave_table(
    cycle: Cycle, device: str, scale: tuple[float, float] | None = None, points: int | None = None
) -> WaveTable:
    """Table of a cycle for a kind of device.

    Parameters
    ----------
    scale : number in the table = scale[0] x volts + scale[1]; volts if the format says so
    points : most points of the table, where the format does not say

    Raises
    ------
    InputError : an unknown device, no scale where one is needed, or a period that no table holds
    """
    if device not in DEVICES:
        raise InputError("--table", f"{device!r} is not one of {', '.join(DEVICES)}")
    kind = DEVICES[device]
    if scale is None and not kind.fixed_unit:
        raise InputError(
            "--table-scale",
            f"a {kind.what} may expect volts, percent or um; give FACTOR[,OFFSET] from V to its unit "
            "(1 for V)",
        )
    hold = _hold(cycle, kind, points)
    volts = cycle.drive_v if hold == 1 else held_least(cycle, cycle.drive_v.shape[1] // hold)
    table = WaveTable(cycle, device, hold, volts, scale or (1.0, 0.0), (0.0, 0.0, 0.0))
    factor, offset = table.scale
    written = (table.numbers() - offset) / factor
    held, as_written = (rms(held_error(cycle, points_v, hold)) for points_v in (volts, written))
    return replace(table, errors_um=(rms(cycle.error_um), held, as_written))


def _hold(cycle: Cycle, kind: Device, points: int | None) -> int:
    """Least number of samples for which a point can be held."""
    samples, time_s = cycle.drive_v.shape[1], cycle.sample_time_s
    most = min(n for n in (kind.most_points, points, samples) if n is not None)
    for hold in range(1, samples // 2 + 1):
        steps = 1.0 if kind.step_s is None else hold * time_s / kind.step_s
        if (
            samples % hold == 0
            and samples // hold <= most
            and abs(steps - round(steps)) < 1e-6
            and steps > 0.5
        ):
            return hold
    step = "" if kind.step_s is None else f", each a multiple of {interval(kind.step_s)}"
    raise InputError(
        "--table",
        f"a period of {samples} samples of {interval(time_s)} is not a whole number of points, at most "
        f"{most}{step}; choose a period of {most} points times a whole number of samples, or another "
        "frequency",
    )
