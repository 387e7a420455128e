"""How sure is an error? Actuators are drawn whose parameters differ from those of the model."""

from matplotlib.figure import Figure

import hammerstein


def main() -> Figure:
    """Draw 20 actuators, and the band of the error over frequency."""
    report = hammerstein.run(
        {
            "question": "How far does 5 % of uncertainty spread the error?",
            "actuator": "duo_bimorph",
            "reference": {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 50.0},
            "sweep": {"frequency_hz": [10.0, 20.0, 50.0, 100.0, 150.0]},
            "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph"}],
            "uncertainty": {"draws": 20, "weights": 0.05},
        }
    )
    for band in report.bands:
        if band.metric == "rms_true_um" and band.excited_axis == band.measured_axis == "x":
            spread = f"{band.p5_um:.2f} to {band.p95_um:.2f}"
            print(f"{band.frequency_hz:5g} Hz: {band.median_um:.2f} um ({spread})")

    from hammerstein.reporting.figures import figures_of

    return figures_of(report)["sweep_true"]


if __name__ == "__main__":
    main().savefig("monte_carlo.png")
