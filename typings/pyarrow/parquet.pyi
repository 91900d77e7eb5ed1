# The part of Arrow that this project uses; the library has no types. tests/test_stubs.py compares it with the library.
from collections.abc import Sequence

from pyarrow import Table

def write_table(table: Table, where: str) -> None: ...
def read_table(source: str, *, columns: Sequence[str] | None = ...) -> Table: ...
