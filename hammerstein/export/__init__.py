"""From a law in Python to C that runs without it, with all that shows that it is the same law."""

from hammerstein.export.c_blocks import CPart as CPart, c_block_of as c_block_of
from hammerstein.export.c_laws import c_law_of as c_law_of
from hammerstein.export.request import Request as Request
