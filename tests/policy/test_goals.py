"""Goal images, present images and latents of a batch are the same pixels, whatever LeRobot was told."""

import numpy as np
import pytest
import torch
from lerobot.datasets import LeRobotDataset

from lerobot_buds.core import CheckpointError
from lerobot_buds.data import LocalDataset, as_floats, cached_frames, scale_images
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.goals import GoalImages

CAMERAS = ("observation.images.front", "observation.images.hand")
SIZE = 40


@pytest.fixture(scope="module", params=[False, True], ids=["images", "videos"])
def dataset(request, tmp_path_factory):
    """Two episodes of noise, 64 x 48 pixels, so that no two frames look alike."""
    root = tmp_path_factory.mktemp("goals") / "two"
    rng = np.random.default_rng(0)
    names = ["height", "width", "channels"]
    image = {"dtype": "video" if request.param else "image", "shape": (48, 64, 3), "names": names}
    features = dict.fromkeys(CAMERAS, image) | {"action": {"dtype": "float32", "shape": (2,), "names": ["x", "y"]}}
    written = LeRobotDataset.create("tests/goals", 10, features, root=root, use_videos=request.param)
    for length in (9, 12):
        for _ in range(length):
            frame = {name: rng.integers(0, 256, (48, 64, 3), dtype=np.uint8) for name in CAMERAS}
            written.add_frame({**frame, "action": np.zeros(2, np.float32), "task": "look"})
        written.save_episode()
    written.finalize()
    return LeRobotDataset("tests/goals", root=root)


def goals_of(dataset, camera: str) -> GoalImages:
    from lerobot.configs import FeatureType, PolicyFeature

    config = BudsConfig(device="cpu", encoder="conv", image_size=SIZE)
    config.input_features = {camera: PolicyFeature(FeatureType.VISUAL, (3, 48, 64))}
    config.workspace_camera = camera
    return GoalImages(dataset.root, config, np.array([0, 9]))


@pytest.mark.parametrize("shown", CAMERAS)
def test_a_renamed_camera_has_the_goals_of_the_same_camera(dataset, shown):
    """The batch calls `shown` by the name of the other camera, or by one that the dataset does not have."""
    index = torch.tensor([2, 11, 20])
    batch = torch.stack([dataset[int(i)][shown] for i in index])
    for name in (*CAMERAS, "observation.images.agentview"):
        goals = goals_of(dataset, name)
        goals.recognise(index.numpy(), batch)
        expected = scale_images(batch, (SIZE, SIZE))
        assert torch.equal(as_floats(torch.from_numpy(goals[index.numpy()])), expected)  # to the last bit


def test_present_goal_and_representation_see_the_same_bits(dataset):
    for camera in CAMERAS:
        frames = cached_frames(dataset, camera, size=(SIZE, SIZE))
        for index in (0, 10):
            shown = dataset[index][camera][None].contiguous(memory_format=torch.channels_last)
            present = scale_images(shown, (SIZE, SIZE))
            stored = torch.from_numpy(frames[[index]]).float().div(255)
            assert torch.equal(present, stored)


def test_pixels_of_no_camera_are_refused_where_the_name_does_not_tell(dataset):
    index, noise = np.array([1, 2]), torch.rand(2, 3, 48, 64)
    with pytest.raises(CheckpointError, match=r"cannot be told.*image_transforms"):
        goals_of(dataset, "observation.images.agentview").recognise(index, noise)
    goals_of(dataset, CAMERAS[0]).recognise(index, noise)  # here the name tells, and a warning is enough


def test_the_decoder_that_lerobot_was_told_is_found_out(dataset):
    for backend in ("torchcodec", "pyav"):
        told = LeRobotDataset("tests/goals", root=dataset.root, video_backend=backend)
        batch = told[3][CAMERAS[0]][None]
        goals = goals_of(dataset, CAMERAS[0])
        goals.recognise(np.array([3]), batch)
        assert torch.equal(as_floats(torch.from_numpy(goals[np.array([3])])), scale_images(batch, (SIZE, SIZE)))
        local = LocalDataset.of(told)
        assert local.video_backend == backend
        assert torch.equal(torch.from_numpy(cached_frames(local, CAMERAS[0])[[3]]).float() / 255, batch)
