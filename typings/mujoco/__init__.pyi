# The wheel ships no types that a checker can follow.
from typing import Any

def __getattr__(name: str) -> Any: ...
