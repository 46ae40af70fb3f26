"""Keeps every test off the Hub and out of the user's folders; records the demonstrations that several tests read."""

import logging
import os
import resource
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import settings

# How long an example takes says more about the machine's other work than about the code.
settings.register_profile("default", deadline=None)
settings.load_profile("default")

# Read by LeRobot, MuJoCo and torch when they are imported.
_HOME = TemporaryDirectory(prefix="buds-tests-")  # removed when the interpreter ends
os.environ["HF_LEROBOT_HOME"] = _HOME.name
os.environ["HF_HUB_OFFLINE"] = "1"
os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # tiny tensors: threads would only wait for one another


@pytest.fixture(autouse=True)
def quiet() -> None:
    """Commands show this package's news; a test that reads the log sees what it asked for, whatever ran before it."""
    logging.getLogger("lerobot_buds").setLevel(logging.NOTSET)


@pytest.fixture
def tasks_of_its_own() -> Iterator[None]:
    """Takes out again what a test, or an example that it runs, adds to the tasks that there are."""
    import gymnasium

    from lerobot_buds.demos.stages import STAGES
    from lerobot_buds.envs import STAGE_FACTS, TASKS

    kept: list[tuple[dict[Any, Any], dict[Any, Any]]] = [
        (names, dict(names)) for names in (TASKS, STAGE_FACTS, STAGES, gymnasium.registry)
    ]
    yield
    for names, before in kept:
        names.clear()
        names.update(before)


@pytest.fixture
def largest_file() -> Callable[[int], AbstractContextManager[None]]:
    """Lets this process's writes beyond a size (bytes) fail, as on a disk that is full; Python ignores the signal."""

    @contextmanager
    def limited(size: int) -> Iterator[None]:
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)

    return limited


@pytest.fixture
def annotate(tmp_path: Path) -> Callable[..., Path]:
    """Annotates a dataset in place by the writer of lerobot-annotate: ``(start, text)`` of the subtasks per episode."""
    from lerobot.annotations.steerable_pipeline.executor import Executor
    from lerobot.annotations.steerable_pipeline.reader import iter_episodes
    from lerobot.annotations.steerable_pipeline.staging import EpisodeStaging
    from lerobot.annotations.steerable_pipeline.writer import LanguageColumnsWriter

    def write(root: Path, subtasks: Sequence[Sequence[tuple[float, str]]], *others: dict[str, Any]) -> Path:
        staging = tmp_path / "staging"
        for number, rows in enumerate(subtasks):
            plain = [{"role": "assistant", "content": c, "style": "subtask", "timestamp": t} for t, c in rows]
            EpisodeStaging(staging, number).write("plan", [*plain, *others])
        LanguageColumnsWriter().write_all(list(iter_episodes(root)), staging, root)
        Executor._ensure_annotation_metadata_in_info(root)
        return root

    return write


@pytest.fixture(scope="session")
def demonstrations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four demonstrations from seeds 0 to 3, 32-pixel video, recorded by two workers. Not to be changed."""
    from lerobot_buds.cli.collect import CollectConfig, collect

    root = tmp_path_factory.mktemp("demonstrations") / "demos"
    summary = collect(
        CollectConfig(
            "tests/demos", episodes=4, root=str(root), workers=2, image_size=32, render_profile="fastest", video=True
        )
    )
    assert (summary.episodes, summary.attempts, summary.failures) == (4, 4, {})
    return root


@pytest.fixture(scope="session")
def segmented(demonstrations: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same demonstrations with three skills at most, of a representation that hardly learnt. Not to be changed."""
    from lerobot_buds.cli.segment import SegmentConfig, segment
    from lerobot_buds.representation import RepresentationConfig
    from lerobot_buds.segmentation import DiscoveryConfig

    folder = tmp_path_factory.mktemp("segmented")
    segment(
        SegmentConfig(
            "tests/demos",
            str(demonstrations),
            output_root=str(folder / "skills"),
            work_dir=str(folder / "work"),
            representation=RepresentationConfig(image_size=32, steps=10, batch_size=32, device="cpu"),
            discovery=DiscoveryConfig(max_skills=3),
        )
    )
    return folder / "skills"


@pytest.fixture(scope="session")
def checkpoint(segmented: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small untrained policy for the segmented demonstrations, as lerobot-train leaves one. Not to be changed."""
    import torch
    from lerobot.datasets import LeRobotDatasetMetadata
    from lerobot.policies import make_policy, make_pre_post_processors

    from lerobot_buds.policy import BudsConfig

    small = {"encoder": "conv", "norm": "group", "conv_channels": [8, 8], "keypoints": 8, "head_widths": [32]}
    folder = tmp_path_factory.mktemp("policy") / "pretrained_model"
    torch.manual_seed(0)
    policy = make_policy(BudsConfig(device="cpu", **small), ds_meta=LeRobotDatasetMetadata("tests/x", root=segmented))
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(policy.config):
        processor.save_pretrained(folder)
    return folder
