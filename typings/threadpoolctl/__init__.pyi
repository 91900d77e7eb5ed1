# The part of threadpoolctl that this project uses. tests/test_stubs.py compares it with the library.
from contextlib import AbstractContextManager
from typing import Any, Literal

class ThreadpoolController:
    def __init__(self) -> None: ...
    def limit(
        self, *, limits: int | None = None, user_api: Literal["blas", "openmp"] | None = None
    ) -> AbstractContextManager[Any]: ...
