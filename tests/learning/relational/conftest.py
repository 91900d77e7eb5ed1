"""Fixtures of the tests of the relational policy."""

from __future__ import annotations

import pytest
from relational_cases import labeled

from roboassembly.learning.datasets import SampleSet


@pytest.fixture(scope="session")
def cantilever() -> SampleSet:
    """Samples of one episode of a chair with four parts."""
    return labeled("cantilever:1")
