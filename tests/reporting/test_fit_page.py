"""The page of a fit: its first lines, its end, and what its figures say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import made_up
import numpy as np
import pytest
from made_up_cases import stage_records
from record_cases import plain

from hammerstein.identification.fit import KIND_NAMES, Fit
from hammerstein.identification.identify import identify
from hammerstein.identification.linear.frequency_response import FrequencyResponse
from hammerstein.identification.settings import Settings
from hammerstein.model import HammersteinModel
from hammerstein.model.covariance import ParameterCovariance
from hammerstein.records.record import Record
from hammerstein.reporting.figures.identified import operators_figure, residual_figure, response_figure
from hammerstein.reporting.fit_page import Asked, fit_page, next_step

SETTINGS = plain(operators=6, partition="fitted")
Found = tuple[HammersteinModel, Fit]


@pytest.fixture(scope="module")
def fits() -> tuple[Found, Found]:
    """One stage, identified with a validation record and without."""
    made = made_up.stage(0, noise_um=0.01, plays=6, rate_hz=5e3)
    fitted, held = stage_records(made, np.random.default_rng(1), cycles=4, hz=5.0)
    return identify(fitted, SETTINGS, validation=[held]), identify(fitted, plain(partition="fitted"))


def _first_lines(found: Found) -> list[str]:
    return fit_page(*found).markdown().split("\n\n")[1].splitlines()


def test_a_fit_report_begins_with_what_it_is_good_for_and_ends_with_thresholds(
    fits: tuple[Found, Found],
) -> None:
    tested, alone = map(_first_lines, fits)
    assert tested[0] == "* **Usable for simulation and compensation**."
    assert tested[1].startswith("* Rms error about the mean of each record: ")
    assert "validation records" in tested[1]
    assert "fitted records" in alone[1]
    assert "untested on other records" in alone[0]
    assert tested[-1].startswith(f"* Next: `hammerstein compensate {fits[0][0].name}.json path.csv --law ")
    assert "with a validation record" in alone[-1]
    assert len(tested) == len(alone) == 5
    headings = [line for line in fit_page(*fits[0]).markdown().splitlines() if line.startswith("## ")]
    assert headings[-1] == "## Thresholds"


def test_a_threshold_of_zero_is_fixed_and_not_open(
    fits: tuple[Found, Found], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [("u", 0.0, None), ("u", 1.5, None), ("u", 2.5, 0.1)]
    monkeypatch.setattr("hammerstein.reporting.fit_page._thresholds", lambda model: found)
    page = fit_page(*fits[0]).markdown()
    assert "| u | 0 | fixed |\n| u | 1.5 | open |\n| u | 2.5 | 0.1 |\n" in page


def test_a_column_that_is_a_number_is_called_a_column(fits: tuple[Found, Found]) -> None:
    model, fit = fits[0]
    page = fit_page(model, replace(fit, outputs=("5", "x [um]")))
    assert " um on column 5, " in page.markdown()
    assert " um on x; " in page.markdown()


def test_the_residual_of_the_kept_model_is_the_one_solid_line(fits: tuple[Found, Found]) -> None:
    _, fit = fits[0]
    over_time, over_hz = residual_figure(fit, fit.held[0], fit.held_starts[0]).axes[:2]
    lines = {line.get_linestyle(): line for line in over_hz.lines}
    assert len(lines) == len(over_hz.lines)
    assert lines["-"].get_zorder() == max(line.get_zorder() for line in over_hz.lines)
    assert all("e-" not in tick.get_text() for tick in over_hz.get_yticklabels())
    assert over_time.get_title("right") == KIND_NAMES[fit.kind]
    assert over_hz.get_title("right") == "all models"


def test_thresholds_fitted_and_not_fitted_have_entries_of_their_own(fits: tuple[Found, Found]) -> None:
    given, fitted = fits[1][1], replace(fits[0][1], error_curve=fits[1][1].error_curve)
    axes_alone = ParameterCovariance(np.eye(60), (), (58, 59), ())  # behind all thresholds
    for fit, own in (
        (fitted, "this model on the validation records, thresholds fitted"),
        (replace(fitted, covariance=axes_alone), "this model on the validation records"),
        (given, "this model on the fitted records"),
    ):
        (legend,) = operators_figure(fit).legends
        words = [text.get_text().replace("\n", " ") for text in legend.get_texts()]
        assert words[0] == f"{fit.outputs[0]}, cross-validation, thresholds not fitted"
        assert words[-1] == own


def test_a_gain_that_is_scatter_is_not_drawn_and_a_flat_one_has_no_peaks(fits: tuple[Found, Found]) -> None:
    _, fit = fits[0]
    hz = np.array([1.0, 2.0, 5.0, 10.0])
    gain = np.array([1.0, 1.01, 1.0, 40.0])
    coherence = np.array([[1.0, 0.99, 0.9, 0.05]] * 2)
    response = FrequencyResponse(
        hz, np.ones((2, 2, 1)) * gain + 0j, coherence, np.ones((2, 2, 4)) + 0j, 0.0 * coherence, 1e-3
    )
    panels = response_figure(fit, response, response).axes
    for o in range(2):
        for axes in panels[3 * o : 3 * o + 2]:
            for line in axes.lines:
                assert not line.get_clip_on()  # a marker at the end of the axis is whole
                np.testing.assert_allclose(line.get_xdata(), hz[:3])
            low, high = axes.get_ylim()
            assert high >= 1.49 * low
            assert axes.get_xlim() == (1.0, 10.0)
        np.testing.assert_allclose(panels[3 * o + 2].lines[0].get_ydata(), coherence[o])


def test_the_table_of_a_fit_keeps_its_words_whole_in_80_columns(fits: tuple[Found, Found]) -> None:
    from rich.console import Console

    from hammerstein.commands.terminal_tables import fit_table

    fit = fits[0][1]
    console = Console(width=80, record=True)
    every = dict.fromkeys(("linear_dynamics", "hammerstein", fit.kind), fit.fit[fit.kind])
    console.print(fit_table(replace(fit, fit=every, outputs=("Weg Kanal 1", "Weg Kanal 2"))))
    lines, last = console.export_text(), fit.validation[fit.kind].rms_um[1]
    for word in ("ation um", f"{last:.3g}\n", "Hammerstein ", "static hysteresis", "Kanal 2", "chosen"):
        assert word in lines.replace(" \n", "\n")
    console.print(fit_table(fits[1][1]))
    assert "ation %" not in console.export_text()


def test_an_error_far_above_the_noise_names_the_command_that_helps(fits: tuple[Found, Found]) -> None:
    model, fit = fits[0]
    found = replace(fit, flags=(), other_kinds=True)
    assert "; hammerstein compare may find a better model." in fit_page(model, found).markdown()
    asked = Asked(Path("m.json"), [Path("a.csv")], ["a.csv", "--validate", "b.csv"])
    assert next_step(model, found, asked) == ("Next:", "hammerstein compare a.csv --validate b.csv")
    assert next_step(model, replace(found, other_kinds=False), asked)[1].startswith("hammerstein compensate")
    blocked = replace(found, invertible=False, invertibility="There is no inverse.")
    words = ("Next, to find a model with an inverse:", "hammerstein compare a.csv --validate b.csv")
    assert next_step(model, blocked, asked) == words
    assert next_step(model, blocked) == ("Next: There is no inverse.", "")  # compensate cannot be next


def test_a_sample_time_is_given_in_us(fits: tuple[Found, Found]) -> None:
    assert "samples of 200 us" in fit_page(*fits[0]).markdown().replace("1 sample of", "samples of")


@pytest.mark.parametrize(("held", "told"), [(40, True), (3, False)])
def test_noise_is_named_where_it_is_noise_and_not_where_the_drive_is_as_fast(held: int, told: bool) -> None:
    """A gain read with 0.01 um of noise: at voltages held for 40 samples, and for so few that all moves."""
    generator = np.random.default_rng(5)
    u = np.repeat(generator.uniform(-10.0, 10.0, 4200 // held), held)
    record = Record([u], [2.0 * u + 0.01 * generator.standard_normal(u.size)], 1e-3)
    settings = Settings(thresholds_v=[0.0], dynamics="none", delay_samples=0)
    said = fit_page(*identify([record], settings)).markdown()
    assert ("includes their noise, 0.01" in said) == told
    assert ("includes their noise" in said) == told
