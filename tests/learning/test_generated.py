"""Names of extra pieces."""

from __future__ import annotations

from roboassembly.learning.generated import EXTRA_SEEDS, extra_names


def test_extra_names_are_of_seen_families_and_of_no_data_set() -> None:
    names = extra_names(40, ("rocker", "splat"))
    assert len(set(names)) == 40
    assert names[:7] == extra_names(7, ("rocker", "splat"))
    families, seeds = zip(*(name.split(":") for name in names), strict=True)
    assert not {"rocker", "splat"} & set(families)
    assert min(map(int, seeds)) >= EXTRA_SEEDS
