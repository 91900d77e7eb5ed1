# The part of Ruckig that this project uses; the wheel ships no types. tests/test_stubs.py compares it with the
# library.
from collections.abc import Sequence

class Result:
    Working: Result

class DurationDiscretization:
    Discrete: DurationDiscretization

class InputParameter:
    current_position: Sequence[float]
    current_velocity: Sequence[float]
    current_acceleration: Sequence[float]
    target_position: Sequence[float]
    target_velocity: Sequence[float]
    target_acceleration: Sequence[float]
    max_velocity: Sequence[float]
    max_acceleration: Sequence[float]
    max_jerk: Sequence[float]
    duration_discretization: DurationDiscretization
    def __init__(self, dofs: int, /) -> None: ...

class Profile:
    t: Sequence[float]
    p: Sequence[float]
    v: Sequence[float]
    a: Sequence[float]
    j: Sequence[float]

class Trajectory:
    profiles: Sequence[Sequence[Profile]]
    def __init__(self, dofs: int, /) -> None: ...

class Ruckig:
    def __init__(self, dofs: int, delta_time: float, /) -> None: ...
    def calculate(self, input: InputParameter, trajectory: Trajectory) -> Result: ...
