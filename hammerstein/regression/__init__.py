"""Guard the numbers: baselines and what moved against them."""
