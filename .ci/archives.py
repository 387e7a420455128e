"""Check that wheel and sdist hold what they need: ``archives.py SOURCE DIST``."""

from __future__ import annotations

import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path


def main(source: Path, dist: Path) -> None:
    """Compare the files of both archives with those of the source."""
    package = {
        path.relative_to(source).as_posix() for path in source.glob("hammerstein/**/*") if path.is_file()
    }
    settings = tomllib.loads((source / "pyproject.toml").read_text())
    version = settings["project"]["version"]
    beside = {  # files of the package that stand elsewhere in the source: their places in both
        f"{place}/{path.name}": path.relative_to(source).as_posix()
        for folder, place in settings["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"].items()
        for path in (source / folder).iterdir()
    }
    name = f"hammerstein_control-{version}"
    with zipfile.ZipFile(dist / f"{name}-py3-none-any.whl") as wheel:
        files = {file.replace(f"{name}.dist-info/licenses/", "") for file in wheel.namelist()}
    refuse_difference(
        "wheel", package | set(beside) | {"LICENSE"}, {f for f in files if ".dist-info/" not in f}
    )
    with tarfile.open(dist / f"{name}.tar.gz") as sdist:
        files = {file.removeprefix(f"{name}/") for file in sdist.getnames()}
    needed = package | set(beside.values()) | {"pyproject.toml", "README.md", "LICENSE"}
    refuse_difference("sdist", needed, files & needed)
    print(f"{len(package)} files of the package in each")


def refuse_difference(archive: str, wanted: set[str], held: set[str]) -> None:
    """Stop where an archive lacks a file or holds one too many."""
    lines = [f"  lacks {file}" for file in sorted(wanted - held)]
    lines += [f"  holds {file}" for file in sorted(held - wanted)]
    if lines:
        sys.exit("\n".join([f"the {archive}", *lines]))


main(Path(sys.argv[1]), Path(sys.argv[2]))
