"""Statistics of features, in the form of a LeRobot data set: of one episode, and of several together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, Shaped

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Quantiles by their names in `stats.json`."""
Statistics = dict[str, np.ndarray]
"""`min`, `max`, `mean`, `std`, `count` and quantiles of one feature."""


def of_rows(rows: Shaped[np.ndarray, "n *dims"]) -> Statistics:
    """Return the statistics of each number of a feature over its frames; those of a scalar have shape (1,)."""
    values = rows.reshape(len(rows), -1).astype(float)
    quantiles = np.quantile(values, list(QUANTILES.values()), axis=0)
    return {
        "min": values.min(axis=0), "max": values.max(axis=0), "mean": values.mean(axis=0), "std": values.std(axis=0),
        "count": np.array([len(rows)]), **dict(zip(QUANTILES, quantiles, strict=True)),
    }  # fmt: skip


def of_histograms(
    histograms: Int[np.ndarray, "channels levels"], values: Float[np.ndarray, "levels"], frames: int
) -> Statistics:
    """Return the statistics of a picture's channels, each of shape (channels, 1, 1), from counts of their levels.

    Args:
        histograms: number of pixels of each level, by channel.
        values: value of each level, ascending.
        frames: number of pictures.
    """
    share = histograms / histograms.sum(axis=1, keepdims=True)
    mean = share @ values
    std = np.sqrt(np.maximum(share @ values**2 - mean**2, 0.0))
    there, sums = histograms > 0, np.cumsum(share, axis=1)
    lowest, highest = there.argmax(axis=1), len(values) - 1 - there[:, ::-1].argmax(axis=1)
    out = {"min": values[lowest], "max": values[highest], "mean": mean, "std": std}
    # The last sum may be a little below 1.
    out |= {name: values[(sums < q - 1e-12).sum(axis=1)] for name, q in QUANTILES.items()}
    return {name: each.reshape(-1, 1, 1) for name, each in out.items()} | {"count": np.array([frames])}


def together(episodes: Sequence[Statistics]) -> Statistics:
    """Return the statistics of a feature over several episodes from those of each.

    Quantiles of all frames do not follow from these. As in LeRobot, the least of all episodes stands for those up to
    the median, and the greatest for those above.
    """
    counts = np.array([int(each["count"][0]) for each in episodes], float)
    stacked = {name: np.stack([each[name] for each in episodes]) for name in episodes[0] if name != "count"}
    weights = (counts / counts.sum()).reshape(-1, *[1] * (stacked["mean"].ndim - 1))
    mean = (weights * stacked["mean"]).sum(axis=0)
    variance = (weights * (stacked["std"] ** 2 + (stacked["mean"] - mean) ** 2)).sum(axis=0)
    out = {
        "min": stacked["min"].min(axis=0), "max": stacked["max"].max(axis=0), "mean": mean, "std": np.sqrt(variance),
        "count": np.array([int(counts.sum())]),
    }  # fmt: skip
    for name, q in QUANTILES.items():
        out[name] = stacked[name].min(axis=0) if q <= 0.5 else stacked[name].max(axis=0)
    return out
