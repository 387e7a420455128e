"""Export of the hysteresis block to python-control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import control

    from hammerstein.hysteresis.prandtl_ishlinskii import Array, PrandtlIshlinskii


def to_nlsys(model: PrandtlIshlinskii, sample_time_s: float, name: str) -> control.NonlinearIOSystem:
    """Discrete nonlinear system: states are the plays, outputs are v = sum of w times the new plays.

    The inputs are ``u[0]`` .., the outputs ``v[0]`` .., the states ``p[0]`` .. (input by input).
    """
    import control

    bank = model.bank
    grids = [bank.r[k, :n] for k, n in enumerate(bank.n)]
    r = np.concatenate(grids)
    weights = np.concatenate([bank.w[k, :n] for k, n in enumerate(bank.n)]).T
    of_input = np.repeat(np.arange(model.n_inputs), bank.n)

    def plays(t: float, x: Array, u: Array, params: dict[str, Any]) -> Array:
        v = np.atleast_1d(u)[of_input]
        return np.maximum(v - r, np.minimum(v + r, x))

    def outputs(t: float, x: Array, u: Array, params: dict[str, Any]) -> Array:
        return np.asarray(weights @ plays(t, x, u, params))

    return control.nlsys(
        plays,
        outputs,
        inputs=[f"u[{k}]" for k in range(model.n_inputs)],
        outputs=[f"v[{o}]" for o in range(model.n_outputs)],
        states=[f"p[{i}]" for i in range(len(r))],
        dt=sample_time_s,
        name=name,
    )
