import subprocess
import sys

import hammerstein


def test_every_public_name_is_there():
    for name in hammerstein.__all__:
        assert getattr(hammerstein, name) is not None
    assert set(hammerstein.__all__) == set(hammerstein._HOME_OF)


def test_the_command_line_imports_nothing_heavy():
    heavy = {"numpy", "numba", "control", "pandas", "pydantic"}
    code = f"import sys, hammerstein.commands.cli; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
