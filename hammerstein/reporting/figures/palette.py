"""Few colours for a line drawing: each ink, half of it for soft edges, and every area as it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hammerstein.arrays import Array
from hammerstein.reporting.figures.style import COLOURS, GRID

Bytes = NDArray[np.uint8]

WHITE = 0xFFFFFFFF
SHIFT = 3
SHADES = 256 >> SHIFT
"""Shades of red, green, and blue within which colours are counted as one."""
FEWEST_OF_AN_INK = 20
"""Pixels of an ink's full colour from which it is in use."""
SHARE_OF_AN_AREA = 0.002
"""Part of all pixels from which a colour is an area's, such as a band's."""
APART = 20.0
"""Distance of an area's colour from those of the palette, below which it is taken for one of them."""
NEUTRAL = 10.0
"""Largest difference between red, green, and blue of a grey."""
DARKEST = 128.0
"""Red, green, and blue of a grey from which it can be an area's: darker ones are lines and letters."""


def in_few_colours(pixels: Bytes) -> tuple[Bytes, Bytes]:
    """Palette of about a dozen colours (number, 3), and each pixel's number in it (row, column).

    No hue shifts: the full colour of an ink is exact. The many shades of its edges become the ink, half of
    it, or white; greys stay grey, and nothing else becomes one.

    Parameters
    ----------
    pixels : (row, column, 4) red, green, blue, and opacity of a drawing on white

    Examples
    --------
    >>> pixels = np.full((2, 40, 4), 255, np.uint8)
    >>> pixels[0, :, :3] = 0x00, 0x72, 0xB2
    >>> palette, numbers = in_few_colours(pixels)
    >>> palette[numbers[:, 0]].tolist()
    [[0, 114, 178], [255, 255, 255]]
    """
    colours = pixels.reshape(-1, 4)
    drawn = np.flatnonzero(pixels.view("<u4").ravel() != WHITE)
    inked = np.take(colours, drawn, axis=0)[:, :3]
    group = _group(inked)
    counts = np.bincount(group, minlength=SHADES**3)
    one_of = np.zeros((SHADES**3, 3))
    one_of[group] = inked  # any colour of its group stands for it
    present, area = np.flatnonzero(counts), SHARE_OF_AN_AREA * len(colours)
    palette = _with_areas(_inked(counts), one_of[np.argsort(-counts)[: np.sum(counts >= area)]])
    place = np.zeros(SHADES**3, np.uint8)
    place[present] = _distances(one_of[present], palette).argmin(axis=1)
    numbers = np.zeros(len(colours), np.uint8)
    numbers[drawn] = place[group]
    return palette.round().astype(np.uint8), numbers.reshape(pixels.shape[:2])


def _group(colours: Bytes) -> NDArray[np.intp]:
    """Number of the group of like colours that each one (number, 3) is in."""
    red, green, blue = (colours >> SHIFT).T.astype(np.intp)
    return np.asarray((red * SHADES + green) * SHADES + blue)


def _inked(counts: NDArray[np.intp]) -> Array:
    """Colours of the paper, the grid, and of each ink in use: full, and half of it (number, 3)."""
    inks = np.array([list(bytes.fromhex(colour[1:])) for colour in COLOURS], np.uint8)
    used = counts[_group(inks)] >= FEWEST_OF_AN_INK
    used[-1] = True  # of letters
    paper, full = np.full((1, 3), 255.0), inks[used].astype(float)
    return np.vstack([paper, full, (paper + full) / 2.0, [list(bytes.fromhex(GRID[1:]))]])


def _with_areas(palette: Array, areas: Array) -> Array:
    """Add the colours of areas, the largest first, that the palette does not hold; no dark grey is one."""
    for area in areas[(np.ptp(areas, axis=1) > NEUTRAL) | (areas[:, 0] > DARKEST)]:
        if _distances(area[None], palette).min() > APART:
            palette = np.vstack([palette, area])
    return palette


def _distances(colours: Array, palette: Array) -> Array:
    """Distance of each colour from each one of the palette; infinite between a hue and a grey."""
    hued, hue = (np.ptp(some, axis=1) > NEUTRAL for some in (colours, palette))
    grey = ~hue & (palette[:, 0] > 0.0) & (palette[:, 0] < 255.0)
    distances = np.linalg.norm(colours[:, None] - palette[None], axis=2)
    return np.where(np.outer(hued, grey) | np.outer(~hued, hue), np.inf, distances)
