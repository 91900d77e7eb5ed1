from jax import Array
from jax.numpy import ArrayLike

def logsumexp(a: ArrayLike, axis: int | None = ...) -> Array: ...
