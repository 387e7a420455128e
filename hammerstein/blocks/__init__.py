"""Interfaces of blocks: laws, drive and sensor, voltages, and their python-control systems."""

from hammerstein.blocks.law import (
    Controller as Controller,
    Law as Law,
    Learner as Learner,
    Memory as Memory,
    checked_reference as checked_reference,
    require_square as require_square,
)
