# The part of JAX that this project uses. JAX ships types, but its transformations take and return functions of any
# kind; here they keep a function's parameters and result. tests/test_stubs.py compares it with the library.
from collections.abc import Callable
from typing import Any, Literal, ParamSpec, TypeVar, overload

from jax import lax as lax
from jax import nn as nn
from jax import numpy as numpy
from jax import tree as tree
from jax._src.basearray import Array as Array

_P = ParamSpec("_P")
_R = TypeVar("_R")
_Aux = TypeVar("_Aux")

def jit(
    fun: Callable[_P, _R],
    /,
    *,
    static_argnums: int | tuple[int, ...] | None = ...,
    donate_argnums: int | tuple[int, ...] | None = ...,
) -> Callable[_P, _R]: ...
@overload
def value_and_grad(
    fun: Callable[_P, tuple[_R, _Aux]], *, has_aux: Literal[True]
) -> Callable[_P, tuple[tuple[_R, _Aux], Any]]: ...
@overload
def value_and_grad(fun: Callable[_P, _R]) -> Callable[_P, tuple[_R, Any]]: ...
def vmap(fun: Callable[_P, _R]) -> Callable[_P, _R]: ...
def checkpoint(fun: Callable[_P, _R]) -> Callable[_P, _R]: ...
def default_backend() -> str: ...
