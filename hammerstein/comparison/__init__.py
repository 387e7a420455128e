"""Every kind of hysteresis and the linear models on the same records, side by side."""
