"""Trials on a simulated actuator: what a person does at the set-up, and what the true positions were."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.compensators.cycle import centred
from hammerstein.compensators.learning import IlcUpdate, ModelUncertainty, ilc_update
from hammerstein.metrics import rms
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant

SETTLING, MEASURED = 5, 20  # periods


@dataclass(frozen=True, eq=False)
class SimulatedTrial:
    """One trial: the true error of its last period, which no learner sees, and what it taught."""

    true_rms_um: float
    ilc_update: IlcUpdate


def simulated_trials(
    plant: Plant,
    model: HammersteinModel,
    law: Law[Any],
    reference_um: Array,
    trials: int,
    seed: int = 0,
    uncertainty: ModelUncertainty | None = None,
) -> list[SimulatedTrial]:
    """Play, measure and learn on an actuator that is not the model.

    The drive goes through the plant's converter, the readings through its sensor with its noise; the
    learner knows the model and the bandwidth of the sensor alone. Learning ends where the noise begins.

    Parameters
    ----------
    plant : the actuator in its set-up
    model, law : what is known of it, and the inverse
    reference_um : (p, N) one period of the path
    trials : at most
    """
    samples = reference_um.shape[1]
    bandwidth = plant.instruments.sensor.bandwidth_hz
    drive, done = centred(law, model, reference_um)[0], []
    for number in range(trials):
        response = plant.respond(np.tile(drive, (1, SETTLING + MEASURED)), [seed, number])
        true = rms(response.position_um[:, -samples:] - reference_um)
        read = response.reading_um[:, SETTLING * samples :]
        taught = ilc_update(model, law, reference_um, drive, read, uncertainty, bandwidth)
        done.append(SimulatedTrial(true, taught))
        if taught.finished:
            break
        drive = taught.drive_v
    return done
