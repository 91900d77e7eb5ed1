"""Threads of the BLAS library."""

from __future__ import annotations

from threadpoolctl import threadpool_info

from roboassembly.parallel.threads import one_blas_thread


def blas_threads() -> list[int]:
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


def test_matrices_are_multiplied_in_one_thread_and_later_in_as_many_as_before() -> None:
    before = blas_threads()
    assert before
    with one_blas_thread():
        assert set(blas_threads()) == {1}
    assert blas_threads() == before
