"""How often the true error lies in the stated band."""
