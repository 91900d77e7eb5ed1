"""Furniture that many tests share."""

from __future__ import annotations

from functools import cache

import pytest

import shapes
from roboassembly.furniture.annotate import annotate
from roboassembly.furniture.generate import generate
from roboassembly.furniture.model import Furniture, Provenance


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
