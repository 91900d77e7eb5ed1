"""Check of the packages that data sets need beyond the package's own."""

from __future__ import annotations

from importlib import import_module
from typing import Literal

from roboassembly.errors import MissingExtraError

FormatName = Literal["lerobot", "hdf5"]
_NEEDS: dict[FormatName, str] = {"lerobot": "pyarrow", "hdf5": "h5py"}


def check_format(name: FormatName) -> None:
    """Check that a format can be written and read.

    Raises:
        MissingExtraError: a package is not installed.
    """
    try:
        import_module(_NEEDS[name])
    except ModuleNotFoundError:
        raise MissingExtraError(_NEEDS[name], "demos") from None
