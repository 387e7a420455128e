"""Examples to run and to change: ``python -m hammerstein.examples.first_loop``. Each draws one figure."""
