"""An actuator of one's own in python-control: inverse and actuator as one system."""

import control
import numpy as np
from matplotlib.figure import Figure

import hammerstein

T = 50e-6


def main() -> Figure:
    """Join an exact inverse and the actuator by the names of their wires, and draw the response."""
    actuator = hammerstein.HammersteinModel.load("duo_bimorph")
    law = hammerstein.ExactInverse().design(actuator, range_v=10.0, sample_time_s=T)
    chain = control.interconnect(
        [law.to_iosys(T), actuator.to_iosys(T, instruments=actuator.instruments, seed=1)],
        inputs=["reference_um[0]", "reference_um[1]"],
        outputs=["position_um[0]", "position_um[1]"],
    )
    time = T * np.arange(1200)
    reference = 20.0 * np.stack([np.sin(300.0 * time), np.sin(200.0 * time)])
    response = control.input_output_response(chain, time, reference)
    error = response.outputs - reference
    print("worst error of each axis [um]:", np.abs(error).max(axis=1).round(2))
    figure: Figure = response.plot().figure
    return figure


if __name__ == "__main__":
    main().savefig("in_python_control.png")
