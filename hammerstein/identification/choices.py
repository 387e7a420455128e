"""Words that choose how a model is identified: the same in scenarios, on the command line and in Python."""

from __future__ import annotations

from typing import Literal

Partition = Literal["auto", "time", "voltage", "fitted"]
Solver = Literal["closed_form", "least_squares", "nonnegative", "invertible"]
DynamicsKind = Literal["auto", "none", "lag", "second_order", "state_space"]
HysteresisKind = Literal["prandtl_ishlinskii", "asymmetric", "rate_dependent", "bouc_wen"]
StartMode = Literal["auto", "rest", "repeated"]
MOST_DEAD_ZONES = 50
