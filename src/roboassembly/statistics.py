"""Success rates and their confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

_Z = 1.959963984540054
"""97.5 % quantile of the standard normal distribution."""


def success(outcomes: Sequence[bool]) -> dict[str, Any]:
    """Return `n`, `success_rate` and its 95 % Wilson interval `ci95` of outcomes; both are None if `n` is 0."""
    n, solved = len(outcomes), sum(outcomes)
    if not n:
        return {"n": 0, "success_rate": None, "ci95": None}
    low, high = wilson(solved, n)
    return {"n": n, "success_rate": solved / n, "ci95": [round(low, 4), round(high, 4)]}


def wilson(solved: int, n: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of `solved` successes in `n` > 0 trials (Wilson 1927, the score interval)."""
    p, weight = solved / n, _Z**2 / n
    middle, half = p + weight / 2.0, _Z * math.sqrt(p * (1.0 - p) / n + weight / (4.0 * n))
    return max(0.0, (middle - half) / (1.0 + weight)), min(1.0, (middle + half) / (1.0 + weight))
