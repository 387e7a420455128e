"""A circle: what does each compensator leave of the error?"""

from matplotlib.figure import Figure

import hammerstein


def main() -> Figure:
    """Follow a circle of 30 um at 80 Hz with three compensators."""
    identified = {"method": "hammerstein"}
    report = hammerstein.run(
        {
            "question": "How far does the tip stray from a 30 um circle at 80 Hz?",
            "actuator": "duo_bimorph",
            "reference": {"kind": "circle", "radius_um": 30.0, "frequency_hz": 80.0, "smooth_start_s": 0.02},
            "compensators": [
                {"label": "none", "law": "none", "identification": identified},
                {"label": "hysteresis", "law": "exact_inverse", "identification": identified},
                {"label": "with dynamics", "law": "hammerstein_inverse", "identification": identified},
            ],
        }
    )
    print(report.to_frame().groupby("compensator")["euclidean_max_true_um"].max())

    from hammerstein.reporting.figures import figures_of

    return figures_of(report)["path"]


if __name__ == "__main__":
    main().savefig("circle.png")
