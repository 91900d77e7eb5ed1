"""Batches of states of different sizes are padded to one of a few lengths, so that JAX compiles few shapes."""

from __future__ import annotations

LENGTHS = (16, 32, 48, 64, 96, 128, 160, 200)
"""Padded numbers of free points; 200 is 20 parts with 10 points each. Beyond, multiples of 100 follow."""


def padded_length(n: int) -> int:
    """Return the least padded length that holds `n` points."""
    return next((length for length in LENGTHS if length >= n), -(-n // 100) * 100)
