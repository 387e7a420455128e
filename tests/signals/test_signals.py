import numpy as np
import pytest

from hammerstein.errors import InputError
from hammerstein.signals import Circle, FromFile, Lissajous, Multisine, Sine, Spiral, Triangle
from hammerstein.signals.signal_files import read_signal

t = np.linspace(0.0, 0.1, 2001)


def test_sine_on_one_axis():
    values = Sine(amplitude=2.0, frequency_hz=30.0, axis=2, phase_deg=90.0).sample(t, 3)
    np.testing.assert_allclose(values[1], 2 * np.cos(2 * np.pi * 30 * t), atol=1e-12)
    assert (values[[0, 2]] == 0.0).all()


def test_sine_on_all_axes():
    values = Sine(amplitude=2.0, frequency_hz=30.0, axis="all").sample(t, 2)
    np.testing.assert_allclose(values, np.tile(2 * np.sin(2 * np.pi * 30 * t), (2, 1)), atol=1e-12)


def test_triangle_is_the_arcsine_of_a_sine():
    values = Triangle(amplitude=3.0, frequency_hz=25.0, axis=1).sample(t, 1)
    expected = 3.0 * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * 25 * t))
    np.testing.assert_allclose(values[0], expected, atol=1e-9)


def test_circle_is_right_to_its_last_digits_however_long_it_turns():
    turns = np.concatenate([np.arange(-40, 41) / 8.0, np.random.default_rng(0).uniform(-1e6, 1e6, 20_000)])
    x, y = Circle(radius=1.0, frequency_hz=1.0, phase_deg=30.0).sample(turns, 2)
    angle = 2.0 * np.arccos(np.longdouble(-1.0)) * (np.mod(turns.astype(np.longdouble), 1.0) + 30.0 / 360.0)
    np.testing.assert_allclose(x, np.cos(angle).astype(float), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(y, np.sin(angle).astype(float), rtol=0.0, atol=1e-15)


def test_circle_keeps_its_radius_and_turns_counterclockwise():
    x, y = Circle(radius=50.0, frequency_hz=50.0).sample(t, 2)
    np.testing.assert_allclose(np.hypot(x, y), 50.0)
    np.testing.assert_allclose(np.unwrap(np.arctan2(y, x)), 2 * np.pi * 50 * t, atol=1e-9)


def test_spiral_is_a_circle_until_the_trigger_and_then_decays():
    radius = np.hypot(*Spiral(radius=50.0, frequency_hz=50.0, trigger_s=0.04, decay_s=0.02).sample(t, 2))
    np.testing.assert_allclose(radius, 50.0 * np.exp(-np.clip(t - 0.04, 0, None) / 0.02))


def test_lissajous_repeats_after_its_period():
    figure = Lissajous(amplitude=50.0, frequency_x_hz=50.0, frequency_y_hz=100 / 3)
    assert figure.period_s == pytest.approx(0.06)
    np.testing.assert_allclose(figure.sample(t, 2), figure.sample(t + 0.06, 2), atol=1e-9)


@pytest.mark.parametrize("ratio", [100.0, 101.0])
def test_frequencies_of_a_figure_differ_by_a_hundred_times_at_most(ratio):
    for x_hz, y_hz in ((ratio, 1.0), (1.0, ratio)):
        asked = {"amplitude": 1.0, "frequency_x_hz": x_hz, "frequency_y_hz": y_hz}
        if ratio > 100.0:
            with pytest.raises(InputError, match="within a factor of 100 of each other"):
                Lissajous(**asked)
        else:
            figure = Lissajous(**asked)
            np.testing.assert_allclose(figure.sample(t, 2), figure.sample(t + figure.period_s, 2), atol=1e-9)


def test_multisine_has_its_lines_and_keeps_its_amplitude():
    signal = Multisine(amplitude=8.0, lowest_hz=10.0, highest_hz=100.0, seed=3)
    time_s = np.arange(2000) * 50e-6
    values = signal.sample(time_s, 2)
    lines = np.abs(np.fft.rfft(values, axis=1)) > 1.0
    assert np.nonzero(lines[0])[0].tolist() == list(range(1, 11))
    assert np.abs(values).max() <= 8.0
    np.testing.assert_allclose(np.sqrt(np.mean(values**2, axis=1)), 8.0 / 3.0, rtol=1e-9)
    assert (values[0] != values[1]).any()


@pytest.mark.parametrize("amplitude", [0.01, 8.0])
def test_the_peak_of_a_multisine_is_its_amplitude_or_its_rms_a_third_of_it(amplitude):
    """Of fifty lines whose peaks mostly go farther; the samples lie close enough together for 1 %."""
    time_s = np.arange(10_000) * 1e-5
    for seed in range(4):
        values = Multisine(amplitude=amplitude, lowest_hz=10.0, highest_hz=1000.0, seed=seed).sample(
            time_s, 2
        )
        parts = np.stack([np.abs(values).max(axis=1), 3.0 * values.std(axis=1)]) / amplitude
        np.testing.assert_allclose(parts.max(axis=0), 1.0, atol=0.01)


def test_smooth_start_begins_at_zero_without_a_jump_in_speed():
    values = Circle(radius=50.0, frequency_hz=50.0, smooth_start_s=0.02).sample(t, 2)
    plain = Circle(radius=50.0, frequency_hz=50.0).sample(t, 2)
    assert (values[:, 0] == 0.0).all()
    assert np.abs(values[:, 1]).max() < 1e-3
    np.testing.assert_array_equal(values[:, t >= 0.02], plain[:, t >= 0.02])


def test_file_is_interpolated_and_held(tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("# a comment\ntime_s,x,y\n1.0,0,0\n1.01,2,-4\n1.02,2,0\n")
    values = FromFile(path=str(path)).sample(np.array([0.0, 0.005, 0.01, 0.5]), 2)
    np.testing.assert_allclose(values, [[0, 1, 2, 2], [0, -2, -4, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("x,y\n1,2\n3,4\n", "time_s"),
        ("time_s\n1\n2\n", "one column for each axis"),
        ("time_s,x\n0,1\n1,two\n2,3\n", "column x, row 3 +'two' is text"),
        ("time_s,x\n0,1\n1,nan\n2,3\n", "column x, row 3 +has no number"),
        ("# note\ntime_s,x\n0,1\n1,\n2,3\n", "column x, row 4"),
        ("time_s,x\n0,1\n2,1\n1,3\n", "row 4: time_s does not increase"),
        ("time_s,x\n0,1\n", "single row"),
        (
            "# note\n\ntime_s,x\n0,1\n1,2,3,4\n2,1\n3,0\n",
            "row 5 +has more columns than the others, which have 2",
        ),
        ("time_s,x,y\n0,0,1,1\n1,1,2,1\n2,2,3,1\n", "rows have more cells than its header"),
    ],
)
def test_file_mistakes_name_the_row(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_signal(path)


@pytest.mark.parametrize(
    "text",
    ["t [ms];x\n0;0,5\n10;-1,25\n", "t\tx\nms\tum\n0\t0.5\n10\t-1.25\n", "t,x\n[ms],[nm]\n0,500\n10,-1250\n"],
)
def test_a_path_is_read_as_a_record_is(tmp_path, text):
    """Separators, decimal commas and a row of units."""
    path = tmp_path / "path.csv"
    path.write_text(text)
    times, values, _ = read_signal(path)
    assert (times.tolist(), values.tolist()) == ([0.0, 0.01], [[0.5, -1.25]])


def test_a_comma_at_the_end_of_each_row_is_no_column(tmp_path):
    path = tmp_path / "path.csv"
    path.write_text("time_s,x\n0,1,\n1,2,\n2,4,\n")
    times, values, names = read_signal(path)
    assert (times.tolist(), values.tolist(), names) == ([0, 1, 2], [[1, 2, 4]], ["x"])


def test_circle_needs_two_axes():
    with pytest.raises(InputError, match="two axes"):
        Circle(radius=1.0, frequency_hz=1.0).sample(t, 3)


def test_an_offset_moves_a_file_and_without_one_it_holds_what_is_sent(tmp_path):
    rows = np.array([[0.0, 1.0, 2.0], [1e-3, -1.0, 5.0]])
    place = tmp_path / "volts.csv"
    place.write_text("time_s,x,y\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    for rest in (0.0, (0.5, -2.0)):
        alone = FromFile(path=str(place)).sample(rows[:, 0], 2, rest)
        moved = FromFile(path=str(place), offset=(3.0, -4.0)).sample(rows[:, 0], 2, rest)
        np.testing.assert_allclose(alone, rows[:, 1:].T)
        np.testing.assert_allclose(moved, rows[:, 1:].T + np.array([[3.0], [-4.0]]))


def test_one_offset_is_that_of_the_axis_that_moves_and_others_are_one_for_each():
    time_s = np.linspace(0.0, 0.02, 200)
    for axes in (1, 2, 3):
        without = Sine(amplitude=2.0, frequency_hz=50.0, axis=1).sample(time_s, axes)
        each = tuple(float(k) for k in range(axes))
        for offset, expected in ((3.0, (3.0, 0.0, 0.0)[:axes]), (each, each)):
            moved = Sine(amplitude=2.0, frequency_hz=50.0, axis=1, offset=offset).sample(time_s, axes)
            np.testing.assert_allclose((moved - without).T, np.tile(expected, (200, 1)), atol=1e-12)
        with pytest.raises(InputError, match=f"there are {axes} axes"):
            Sine(amplitude=2.0, frequency_hz=50.0, axis=1, offset=(1.0,) * (axes + 1)).sample(time_s, axes)


@pytest.mark.parametrize("rest", [(0.0, 0.0), (40.0, 0.0), (0.0, -3.0), (40.0, -3.0)])
def test_a_signal_stands_where_each_axis_rests(rest):
    """One axis at rest at 0 does not take the other one there."""
    sine = Sine(amplitude=2.0, frequency_hz=5.0)
    time_s = np.arange(50) * 1e-3
    expected = sine.sample(time_s, 2) + np.array(rest)[:, None]
    np.testing.assert_allclose(sine.sample(time_s, 2, rest), expected, rtol=1e-12)
