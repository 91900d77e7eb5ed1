from collections.abc import Callable
from typing import TypeVar

_T = TypeVar("_T")
_X = TypeVar("_X")
_Y = TypeVar("_Y")

# A function of one row is applied to stacks of rows; types do not tell the two apart.
def map(f: Callable[[_X], _Y], xs: _X) -> _Y: ...
def scan(f: Callable[[_T, _X], tuple[_T, _Y]], init: _T, xs: _X) -> tuple[_T, _Y]: ...
def stop_gradient(x: _T) -> _T: ...
