"""The first loop: how far does an actuator go, and how wide is its loop?"""

from matplotlib.figure import Figure

import hammerstein


def main() -> Figure:
    """Drive each input with a slow sine, and draw the loops."""
    report = hammerstein.run(
        {
            "question": "How large is a loop?",
            "actuator": "duo_bimorph",
            "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 10.0},
        }
    )
    table = report.to_frame()
    print(table[["excited_axis", "measured_axis", "height_um", "width_percent"]].to_string(index=False))

    from hammerstein.reporting.figures import figures_of

    return figures_of(report)["loops"]


if __name__ == "__main__":
    main().savefig("first_loop.png")
