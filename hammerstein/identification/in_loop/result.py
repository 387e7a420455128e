"""Model and fit report of a search for hysteresis in a loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import LinearBlock
from hammerstein.identification.fit import Fit, Kind
from hammerstein.identification.fit_report import left_out, model_of, offsets
from hammerstein.identification.in_loop.parameters import LoopParameters
from hammerstein.identification.in_loop.selection import start_of
from hammerstein.identification.model_selection import Trial
from hammerstein.identification.residual_analysis import record_flags
from hammerstein.identification.score import Candidate, Score, score
from hammerstein.identification.sensor_model import SensorModel
from hammerstein.identification.state_space_candidates import gain_model, state_space
from hammerstein.identification.static.static_block import half_swing
from hammerstein.identification.verdict import verdict
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

INVERSE = "compensate finds the voltages of a path in passes, and says whether they converge"


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search: the loop, the linear dynamics beside it, and every structure that was tried."""

    loop: LoopParameters
    block: LinearBlock
    trials: tuple[Trial, ...]

    @property
    def linear(self) -> Trial:
        """Linear dynamics on the selection experiments."""
        return self.trials[0]

    @property
    def chosen(self) -> Trial:
        """The chosen structure on the selection experiments, before all experiments were fitted."""
        return next(trial for trial in self.trials if trial.kept)


def result_of(
    found: Found,
    records: tuple[Record, ...],
    held: tuple[Record, ...],
    name: str,
    sensor: SensorModel,
    notes: Sequence[str] = (),
) -> tuple[HammersteinModel, Fit]:
    """Model and fit report.

    records, held : fitted and validation records, settled periods counted from one voltage
    sensor : of the records, which are freed of it
    notes : on the search
    """
    one, straight = records[0], gain_model(np.eye(len(records[0].u_v)))
    candidates: dict[Kind, Candidate] = {
        "linear_dynamics": Candidate(straight, state_space(found.block)),
        "in_loop": Candidate(straight, found.loop.dynamics(one.sample_time_s)),
    }
    best, starts, held_starts = candidates["in_loop"], *(tuple(map(start_of, own)) for own in (records, held))
    fitted = _scores(candidates, records)
    judged = _scores(candidates, held) if held else {}
    flags = tuple(record_flags(best, [*records, *held], [*starts, *held_starts]))
    swing = half_swing(records)
    fit = Fit(
        inputs=one.inputs,
        outputs=one.outputs,
        kind="in_loop",
        fit=fitted,
        validation=judged,
        solver="simulated_output",
        operators=straight.operators,
        amplitude_v=float(swing.max()),
        amplitudes_v=tuple(swing.tolist()),
        voltages=_voltages(records),
        sample_time_s=one.sample_time_s,
        sensor_bandwidth_hz=sensor.bandwidth_hz,
        sensor_delay_s=sensor.delay_s,
        offsets_um=offsets(best, records, starts),
        starts=starts,
        held_starts=held_starts,
        trials=found.trials,
        order=len(found.loop.B),
        flags=flags,
        notes=(*notes, *left_out([*records, *held])),
        invertible=True,
        invertibility=INVERSE,
        verdict=verdict(judged or fitted, bool(judged), flags, kept="in_loop"),
        candidates=candidates,
        records=records,
        held=held,
    )
    return model_of(fit, best, name, None), fit


def _scores(candidates: Mapping[Kind, Candidate], records: Sequence[Record]) -> dict[Kind, Score]:
    starts = [start_of(record) for record in records]
    return {kind: score(candidate, records, starts) for kind, candidate in candidates.items()}


def model_so_far(loop: LoopParameters, records: Sequence[Record], name: str) -> HammersteinModel:
    """Model of a search that goes on, without a verdict; InputError if it is not stable.

    records : fitted records, settled periods counted from one voltage
    """
    one, most_v = records[0], float(half_swing(records).max())
    model = loop.model(name, one.sample_time_s, most_v, one.inputs, one.outputs)
    instruments = Instruments.ideal(one.sample_time_s)
    return replace(model, instruments=instruments, voltages=_voltages(records))


def _voltages(records: Sequence[Record]) -> Voltages:
    sent = np.hstack([record.u_v + record.rest_v[:, None] for record in records])
    return Voltages.of(records[0].rest_v, sent.min(axis=1), sent.max(axis=1))
