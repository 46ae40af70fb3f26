"""Lends robosuite numpy's global generator, from which it draws, to one thread at a time."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

import numpy as np

_LENT = Lock()


@contextmanager
def global_generator(seed: int) -> Iterator[None]:
    """Seeds numpy's global generator for as long as robosuite may draw from it; it is as before afterwards.

    ``lerobot-eval`` runs several tasks in threads: whoever builds or resets a robosuite environment has to ask for the
    generator here, even where it makes no use of what is drawn, for else it takes numbers away from another thread.

    Args:
        seed: In ``[0, 2**32)``.
    """
    with _LENT:
        before = np.random.get_state()  # noqa: NPY002
        np.random.seed(seed)  # noqa: NPY002
        try:
            yield
        finally:
            np.random.set_state(before)  # noqa: NPY002
