"""Furniture that many tests share."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import pytest

import shapes
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.generate import generate
from roboassembly.furniture.model import Furniture, Provenance


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests neither find nor leave anything in the user's cache folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROBOASSEMBLY_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@cache
def _chair(family: str, seed: int) -> Furniture:
    return annotate(f"{family}-{seed}", generate(family, seed), Provenance("generated", f"{family}-{seed}"))


@pytest.fixture(scope="session")
def chair():
    """`chair(family, seed)`: annotated generated furniture, made once a session."""
    return _chair


@pytest.fixture(scope="session")
def table() -> Furniture:
    return shapes.table()


@pytest.fixture(scope="session")
def stand() -> Furniture:
    return shapes.stand()


@pytest.fixture(scope="session")
def armchair() -> Furniture:
    return shapes.armchair()


@pytest.fixture(scope="session")
def captive_slat() -> Furniture:
    return shapes.captive_slat()
