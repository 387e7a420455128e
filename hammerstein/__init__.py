"""Simulate, identify and compensate multi-axis actuators with hysteresis.

Conventions
-----------
* Signals are arrays (axis, sample), time last. Weights are arrays (output, input, operator).
* Units are V, um, s, Hz; public names state them, such as ``rms_um`` and ``frequency_hz``.
* Blocks start at rest. The memory of a block is an explicit state that it takes and returns.
  ``respond`` on a whole signal and ``step`` on one sample give identical numbers.
* A voltage is constant over each sample; the linear block is discretised exactly for this.

Examples
--------
>>> import hammerstein
>>> actuator = hammerstein.HammersteinModel.load("duo_bimorph_static")
>>> actuator.hysteresis.amplitude(10.0).round(2)
array([[58.4 ,  1.41],
       [ 2.08, 50.57]])
"""

from hammerstein.notebook_repr import show_with

# Nothing else is imported here: the command line must answer at once, and Ctrl-C must work from the start.


def _html_of(value: object) -> str:
    from hammerstein.reporting.notebook import html_of

    return html_of(value)


show_with(_html_of)


def __getattr__(name: str) -> object:
    if name == "__version__":  # looking it up reads the metadata of the installation, which takes a while
        from importlib.metadata import version

        return version("hammerstein-control")
    find, _, names = _public()
    return names if name == "__all__" else find(name)


def __dir__() -> list[str]:
    return list(_public()[2])


def _public():  # type: ignore[no-untyped-def]  # a stub hides this file from mypy
    """Read the public names, which stand in ``__init__.pyi`` alone; each is imported when it is used."""
    import lazy_loader

    return lazy_loader.attach_stub(__name__, __file__)
