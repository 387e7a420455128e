"""Linear dynamics from records: resonances, state space, delay, creep."""
