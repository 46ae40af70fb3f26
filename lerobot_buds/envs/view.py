"""What demonstrators may ask of a running simulation, whoever runs it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class SimulationView(Protocol):
    """The true state in the task's terms: metres and radians, in the world's frame."""

    @property
    def hand(self) -> NDArray[np.float64]:
        """Position of the point between the fingertips, shape (3,)."""
        ...

    def position(self, body: str) -> NDArray[np.float64]:
        """Position of a body's origin, shape (3,)."""
        ...

    def point_on(self, body: str, local: NDArray[np.float64]) -> NDArray[np.float64]:
        """Converts a point from a body's frame, shape (3,)."""
        ...

    def joint(self, name: str) -> float:
        """Position of a hinge or slide joint."""
        ...
