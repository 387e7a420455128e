"""Programs to read, to run and to change: ``python -m hammerstein.examples.first_loop``."""
