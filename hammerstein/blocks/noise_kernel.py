"""Compiled standard normal numbers: those of NumPy's generator to the last bit, in half its time.

The ziggurat: 256 layers of one area cover the density. A word of the generator names a layer, a sign and a
place in it; all but 1 in 80 places lie below the density in the whole layer and are the number already.
NumPy and numba ask the sign by a branch, which no processor can predict; here it is a factor.

Source: Marsaglia and Tsang, Journal of Statistical Software 5 (2000), no. 8; the tables are NumPy's, as numba
has them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.np.random import distributions, generator_core
from numba.np.random._constants import fi_double, ki_double, wi_double, ziggurat_nor_inv_r, ziggurat_nor_r

from hammerstein.compiled import helper

next_uint64: Any = generator_core.next_uint64  # numba has no types
next_double: Any = generator_core.next_double
standard_normal: Any = distributions.random_standard_normal

at = np.uint64  # a word of the generator, and an index that is not tested for Python's counting from the end

PLACE = 0x000FFFFFFFFFFFFF


@helper()
def draw(bits, samples, drawn):  # type: ignore[no-untyped-def]
    """Draw from a bit generator, sample by sample: drawn (p, N), overwritten from its beginning."""
    for i in range(samples):
        for o in range(drawn.shape[0]):
            word = next_uint64(bits)
            layer, place = word & at(0xFF), (word >> at(9)) & at(PLACE)
            sign = 1.0 - 2.0 * np.int64((word >> at(8)) & at(1))
            x = sign * (np.int64(place) * wi_double[layer])
            if place >= ki_double[layer]:
                x = _beyond(bits, np.int64(layer), place, x)
            drawn[at(o), at(i)] = x


@helper()
def _beyond(bits, layer, place, x):  # type: ignore[no-untyped-def]
    """Number of a place that its layer alone does not decide: x, one of the tail, or another one."""
    if layer == 0:
        while True:
            far, height = -ziggurat_nor_inv_r * np.log1p(-next_double(bits)), -np.log1p(-next_double(bits))
            if height + height > far * far:
                return -(ziggurat_nor_r + far) if (place >> at(8)) & at(1) else ziggurat_nor_r + far
    step = fi_double[layer - 1] - fi_double[layer]
    if step * next_double(bits) + fi_double[layer] < np.exp(-0.5 * x * x):
        return x
    return standard_normal(bits)
