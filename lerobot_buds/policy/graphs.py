"""Training steps as two CUDA graphs, forward and backward, in the place of thousands of kernels launched one by one.

A graph repeats the same kernels on the same memory, so every skill and meta controller gets a fixed number of rows:
what has been seen of its share, and some more. The first steps, which show the shares, and what does not fit later, as
batches of another size, are computed as without graphs; both give the same numbers but for rounding.
"""

import logging
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, Protocol, cast

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from .grouping import Grouping, capacities
from .model import BudsModel, Sample

logger = logging.getLogger(__name__)

WATCHED = 20
"""Steps that show the shares (ours)."""

REHEARSALS = 3
"""Runs before the recording, in which libraries choose their kernels (PyTorch's number)."""

Work = Callable[[], Sequence[Tensor | None]]


class Recorder(Protocol):
    """Records work on a device, so that it can be run again without being told anew."""

    def rehearse(self, work: Callable[[], object]) -> None:
        """Runs some work as it will be recorded."""

    def record(self, work: Work) -> tuple[Sequence[Tensor | None], Callable[[], None]]:
        """Returns the tensors into which the work writes, and what does it again."""


class CudaGraphs:
    """Records CUDA graphs that share their memory, for passes that run one after the other."""

    def __init__(self) -> None:
        # One stream for all: libraries keep their workspaces by streams, and have them before the recording.
        self._stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        self._pool = torch.cuda.graph_pool_handle()

    def rehearse(self, work: Callable[[], object]) -> None:
        """Runs some work as it will be recorded."""
        self._stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self._stream):
            work()
        torch.cuda.current_stream().wait_stream(self._stream)

    def record(self, work: Work) -> tuple[Sequence[Tensor | None], Callable[[], None]]:
        """Returns the tensors into which the work writes, and what does it again.

        Meanwhile other threads may use the GPU: LeRobot's loader pins memory in one, and collectives are watched.
        """
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=self._pool, stream=self._stream, capture_error_mode="thread_local"):
            written = work()
        return written, graph.replay


class Replay:
    """A function of tensors and parameters whose forward and backward pass have been recorded.

    As with `torch.cuda.make_graphed_callables`, which knows neither other threads nor parameters without a gradient at
    some steps, there is one result at a time: it is gone with the next call, and its gradients lie in the parameters.

    Args:
        compute: Called with as many tensors as `inputs`; returns tensors by name, the same names every time.
        parameters: Of those that need a gradient, one is computed.
        inputs: What it is recorded with, without gradients.
        recorder: Records.
    """

    def __init__(
        self,
        compute: Callable[..., dict[str, Tensor]],
        parameters: Iterable[nn.Parameter],
        inputs: Sequence[Tensor],
        recorder: Recorder,
    ) -> None:
        self.parameters = [parameter for parameter in parameters if parameter.requires_grad]
        self.calls = 0
        self._inputs = [tensor.clone() for tensor in inputs]
        self._names: list[str] = []
        live: list[Tensor] = []  # results, as long as their autograd graph is wanted

        def forward() -> list[Tensor]:
            results = compute(*self._inputs)
            self._names, live[:] = list(results), results.values()
            return [result.detach() for result in live]

        def backward() -> list[Tensor | None]:
            with torch.autocast(self._inputs[0].device.type, enabled=False):
                trained = [result for result in live if result.requires_grad]
                found = torch.autograd.grad(trained, self.parameters, self._upstream, allow_unused=True)
            return [None if gradient is None else gradient.contiguous() for gradient in found]

        def rehearsal() -> None:
            for _ in range(REHEARSALS):
                forward()
                self._upstream = [torch.zeros_like(result) for result in live if result.requires_grad]
                backward()
            self.is_trained = [result.requires_grad for result in live]

        device = self._inputs[0].device
        # What is drawn here would be missing from the run, which is to go on as it would without graphs.
        with torch.random.fork_rng([device] if device.type == "cuda" else []):
            recorder.rehearse(rehearsal)
            live.clear()
            written, self._run_forward = recorder.record(forward)
            gradients, self._run_backward = recorder.record(backward)
        live.clear()
        self._results, self._gradients = cast(list[Tensor], written), gradients

    def __call__(self, inputs: Sequence[Tensor], without: Collection[int] = ()) -> dict[str, Tensor]:
        """Runs the forward pass.

        Args:
            inputs: Of the shapes that it was recorded with.
            without: ``id`` of parameters that had no part in the results, and get no gradient.
        """
        for kept, given in zip(self._inputs, inputs, strict=True):
            kept.copy_(given, non_blocking=True)
        results = _Replayed.apply(self, frozenset(without), *self.parameters)  # type: ignore[no-untyped-call]
        return dict(zip(self._names, results, strict=True))

    def run_forward(self) -> list[Tensor]:
        """Runs the recorded forward pass, and returns its results."""
        self.calls += 1
        self._run_forward()
        return [result.detach() for result in self._results]

    def run_backward(self, upstream: Iterable[Tensor]) -> list[Tensor | None]:
        """Runs the recorded backward pass on gradients of the results that have one, and returns the parameters'."""
        for kept, given in zip(self._upstream, upstream, strict=True):
            kept.copy_(given)
        self._run_backward()
        return [None if gradient is None else gradient.detach() for gradient in self._gradients]


class _Replayed(torch.autograd.Function):
    """A replay as a node of the autograd graph."""

    @staticmethod
    def forward(ctx: Any, replay: Replay, without: frozenset[int], *parameters: Tensor) -> tuple[Tensor, ...]:
        results = replay.run_forward()
        ctx.replay, ctx.without, ctx.call = replay, without, replay.calls
        ctx.mark_non_differentiable(*(r for r, trained in zip(results, replay.is_trained, strict=True) if not trained))
        return tuple(results)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *upstream: Tensor) -> tuple[Tensor | None, ...]:
        replay: Replay = ctx.replay
        if replay.calls != ctx.call:
            raise RuntimeError("cuda_graphs keeps the last step alone, and another came before this one's gradients.")
        trained = [gradient for gradient, wanted in zip(upstream, replay.is_trained, strict=True) if wanted]
        gradients = replay.run_backward(trained)
        pairs = zip(replay.parameters, gradients, strict=True)
        return None, None, *(None if id(p) in ctx.without else gradient for p, gradient in pairs)


class GraphedSteps:
    """Computes the terms of training losses by graphs, where a step fits them.

    Args:
        model: In training; its networks compute every row for itself, that is without batch statistics.
        recorder: Records; CUDA graphs where not given.
    """

    def __init__(self, model: BudsModel, recorder: Recorder | None = None) -> None:
        self._model, self._recorder = model, recorder
        controllers = model.meta_controllers
        self._networks = [list(model.skills.skills), list(controllers.controllers) if controllers else [nn.Identity()]]
        self._counts = [torch.zeros(len(networks), dtype=torch.int64) for networks in self._networks]
        self._watched = self._largest = 0
        self._replay: Replay | None = None
        self._capacities: list[list[int]] = []
        self._recorded_with: object = None
        self._addresses: list[int] = []

    def __call__(self, sample: Sample) -> dict[str, Tensor]:
        """Computes what `BudsModel.terms` returns."""
        if self._watched < WATCHED or len(sample.skill) != self._largest:
            groupings = self._model.groupings(sample)
            self._watch(groupings)
            return self._model.terms(sample, groupings)
        if not self._capacities:
            self._capacities = [capacities(counts, self._largest) for counts in self._counts]
        by_skill = Grouping.padded(sample.skill, self._capacities[0])
        by_task = Grouping.padded(sample.task, self._capacities[1])
        if by_skill is None or by_task is None:
            return self._model.terms(sample)
        inputs = (*sample.tensors, *by_skill.tensors, *by_task.tensors)
        replay = self._replay_for(inputs, by_skill, by_task)
        if replay is None:
            return self._model.terms(sample)
        idle = zip(self._networks, (by_skill, by_task), strict=True)
        networks = [n for some, grouping in idle for n, size in zip(some, grouping.sizes, strict=True) if size == 0]
        return replay(inputs, without=[id(p) for network in networks for p in network.parameters()])

    def _watch(self, groupings: tuple[Grouping, Grouping]) -> None:
        self._watched += 1
        for counts, grouping in zip(self._counts, groupings, strict=True):
            counts[list(grouping.numbers)] += torch.tensor(grouping.sizes)
        self._largest = max(self._largest, sum(groupings[0].sizes))

    def _replay_for(self, inputs: Sequence[Tensor], by_skill: Grouping, by_task: Grouping) -> Replay | None:
        """Finds the recording, or makes one; None where the step is another than what was recorded."""
        device = inputs[0].device.type
        precision = torch.is_autocast_enabled(device), torch.get_autocast_dtype(device)
        setting = precision, [(tensor.shape, tensor.dtype) for tensor in inputs]
        if self._replay is not None and setting != self._recorded_with:
            return None
        if self._replay is None or self._addresses != _addresses(self._replay):
            self._replay = None  # its memory is free for the next
            recorder = self._recorder or CudaGraphs()
            compute = _computing(self._model, by_skill, by_task)
            with torch.autocast(device, precision[1], enabled=precision[0], cache_enabled=False):
                self._replay = Replay(compute, self._model.parameters(), inputs, recorder)
            self._recorded_with, self._addresses = setting, _addresses(self._replay)
            logger.info("Training steps are CUDA graphs now; skills have room for %s rows.", self._capacities[0])
        # Gradients that are there lie in memory that a replay writes to; to these more are added the usual way.
        return None if any(p.grad is not None for p in self._replay.parameters) else self._replay


def _addresses(replay: Replay) -> list[int]:
    """Lists where the parameters are: in another place, as after a move to another device, a recording is void."""
    return [parameter.data_ptr() for parameter in replay.parameters]


def _computing(model: BudsModel, by_skill: Grouping, by_task: Grouping) -> Callable[..., dict[str, Tensor]]:
    """Makes a function of the tensors of a sample and of the rows of its groupings."""
    rows = len(by_skill.tensors)

    def compute(*tensors: Tensor) -> dict[str, Tensor]:
        count = len(tensors) - rows - len(by_task.tensors)
        groupings = (
            by_skill.with_tensors(tensors[count : count + rows]),
            by_task.with_tensors(tensors[count + rows :]),
        )
        return model.terms(Sample(*tensors[:count]), groupings)

    return compute
