"""What sits on a wire: laws, drive and sensor, the voltages between them, and python-control at every one."""

from hammerstein.blocks.law import (
    Controller as Controller,
    Law as Law,
    Learner as Learner,
    checked_reference as checked_reference,
    require_square as require_square,
)
from hammerstein.blocks.memory import Memory as Memory
