"""Batches on a device as fast as it takes them: out of its own memory, or fetched ahead by a thread.

Three ways, the same batches. A GPU keeps all chosen frames, as bytes, where they fit; a step then moves nothing but
indices. Where they do not fit, or are read only once, a thread copies the next batches into page-locked memory while
the GPU computes. A CPU reads the frame store as it goes: it has no time to spare that a thread could use.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lerobot_buds.core import IntArray

from .inputs import DatasetInputs, as_batch

DEVICE_SHARE = 0.5
"""Part of the free memory of a GPU that frames may take (ours): the rest is for the network, and for others."""

AHEAD = 2
"""Batches that are fetched before they are asked for (ours): one is copied while the next is read."""

_PORTION = 256  # frames copied to the device at once


class Feed:
    """Batches of a dataset on one device.

    Args:
        inputs: The dataset.
        device: Where the batches go.
        again: Frames are going to be asked for more than once, so it pays to keep them on the device.
    """

    def __init__(self, inputs: DatasetInputs, device: torch.device, again: bool) -> None:
        self.inputs, self.device = inputs, device
        row_bytes = sum(array[0].nbytes for array in inputs.arrays.values())
        keep = again and fits(len(inputs.rows) * row_bytes, device)
        self._kept = _moved(inputs.arrays, inputs.rows, device) if keep else None

    def batches(self, wanted: Iterable[IntArray]) -> Iterator[dict[str, Tensor]]:
        """Fetches batch after batch.

        Args:
            wanted: ``(B,)`` absolute frame indices of every batch; read a little ahead of the batches.

        Returns:
            What `DatasetInputs.batch` gives for each of them, on the device.
        """
        if self._kept is not None:
            return map(self._select, wanted)
        if self.device.type == "cuda":
            return map(self._upload, fetched_ahead(self._read, wanted))
        return (self.inputs.batch(indices, self.device) for indices in wanted)

    def _select(self, indices: IntArray) -> dict[str, Tensor]:
        assert self._kept is not None
        places = sent(torch.from_numpy(np.searchsorted(self.inputs.rows, indices)), self.device)
        return as_batch({name: kept.index_select(0, places) for name, kept in self._kept.items()})

    def _read(self, indices: IntArray) -> dict[str, Tensor]:
        return {name: _gathered(array, indices, self.device) for name, array in self.inputs.arrays.items()}

    def _upload(self, read: Mapping[str, Tensor]) -> dict[str, Tensor]:
        return as_batch({name: tensor.to(self.device, non_blocking=True) for name, tensor in read.items()})


def fits(needed: int, device: torch.device) -> bool:
    """Decides whether frames are kept on a device: on a GPU that has room for them, see `DEVICE_SHARE`.

    Args:
        needed: What they take (bytes).
        device: The device; a CPU has them in the frame store already.
    """
    return device.type == "cuda" and needed <= DEVICE_SHARE * torch.cuda.mem_get_info(device)[0]


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """Sends a small tensor of the CPU to a device; a GPU does not let its sender wait."""
    return tensor.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else tensor.to(device)


def fetched_ahead[T, R](fetch: Callable[[T], R], wanted: Iterable[T]) -> Iterator[R]:
    """Calls a function for one item after the other in a thread, `AHEAD` items before the results are asked for.

    Args:
        fetch: Called in the thread, in order; what it raises is raised where its result is asked for.
        wanted: Its arguments, read in the thread that asks.

    Yields:
        The results, in order.
    """
    with ThreadPoolExecutor(1, "feed") as thread:
        waiting: deque[Future[R]] = deque()
        for item in wanted:
            waiting.append(thread.submit(fetch, item))
            if len(waiting) > AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _moved(arrays: Mapping[str, NDArray[Any]], rows: IntArray, device: torch.device) -> dict[str, Tensor]:
    """Copies rows of all arrays to a device, in portions that the memory of the machine does not notice."""
    moved = {}
    for name, array in arrays.items():
        moved[name] = _empty(array, len(rows), device=device)
        for start in range(0, len(rows), _PORTION):
            portion = _gathered(array, rows[start : start + _PORTION], device)
            moved[name][start : start + _PORTION].copy_(portion, non_blocking=True)
    return moved


def _gathered(array: NDArray[Any], indices: IntArray, device: torch.device) -> Tensor:
    """Copies rows of an array into memory from where they go to a device; other threads go on meanwhile."""
    rows = _empty(array, len(indices), pin_memory=device.type == "cuda")
    np.take(array, indices, axis=0, out=rows.numpy(), mode="clip")  # other modes copy twice
    return rows


def _empty(array: NDArray[Any], length: int, **place: Any) -> Tensor:
    return torch.empty(
        (length, *array.shape[1:]), dtype=torch.uint8 if array.dtype == np.uint8 else torch.float32, **place
    )
