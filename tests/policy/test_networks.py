import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from torch import nn

from lerobot_buds.core import ACTION, EYE_IN_HAND_CAMERA, STATE, WORKSPACE_CAMERA
from lerobot_buds.data import scale_images
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.meta_controller import MetaController, Situation
from lerobot_buds.policy.networks import SpatialSoftmax, make_conv_trunk, make_norm, random_shift
from lerobot_buds.policy.skills import SkillLibrary


def paper_config(n_skills=6, **overrides):
    camera = PolicyFeature(type=FeatureType.VISUAL, shape=(3, 128, 128))
    return BudsConfig(
        device="cpu",
        fps=20,
        n_skills=n_skills,
        input_features={
            WORKSPACE_CAMERA: camera,
            EYE_IN_HAND_CAMERA: camera,
            STATE: PolicyFeature(type=FeatureType.STATE, shape=(9,)),
        },
        output_features={ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(4,))},
        current_dims=list(range(7)),
        history_dims=[7, 8],
        **overrides,
    )


def situation(images, memory=0, **changes):
    """What a meta controller decides from that sees images alone."""
    rows = len(images)
    told = {"proprio": torch.zeros(rows, 0), "memory": torch.zeros(rows, memory)}
    told |= {"remembers": torch.ones(rows, 1, dtype=torch.bool), "task": torch.zeros(rows, dtype=torch.int64)}
    return Situation(images=images, **{**told, **changes})


def meta_controller(config):
    return MetaController(config, n_tasks=0, memory=0, map_channels=0)


def count(module: nn.Module) -> int:
    return sum(p.numel() for p in module.parameters())


def test_paper_sizes():
    config = paper_config()
    assert config.proprio_size == 17
    # Counted by hand from the layer table: ResNet-18 trunks of 6 and 3 channels, keypoints, heads.
    library = SkillLibrary(config)
    assert [count(skill) for skill in library.skills] == [14_186_572] * 6 and count(library) == 6 * 14_186_572
    assert count(meta_controller(paper_config(decoder_sees_skill=False, meta_proprioception=False))) == 11_997_758


def test_group_norm_replaces_every_batch_norm():
    library = SkillLibrary(paper_config(norm="group", n_skills=1))
    assert not any(isinstance(m, nn.BatchNorm2d) for m in library.modules())


def test_spatial_softmax_finds_the_peak():
    maps = torch.full((1, 2, 5, 9), -50.0)
    maps[0, 0, 0, 8] = 50  # top right
    maps[0, 1, 4, 4] = 50  # bottom centre
    torch.testing.assert_close(SpatialSoftmax()(maps), torch.tensor([[1.0, 0.0, -1.0, 1.0]]))


def test_conv_trunk_keeps_an_eighth_of_the_resolution():
    trunk, channels = make_conv_trunk(6, "group", [8, 16, 32])
    assert channels == 32
    assert trunk(torch.zeros(2, 6, 64, 64)).shape == (2, 32, 8, 8)


def test_norm_kinds():
    assert isinstance(make_norm("batch")(32), nn.BatchNorm2d)
    assert make_norm("group")(32).num_groups == 2
    assert make_norm("group")(8).num_groups == 1


@pytest.mark.parametrize("padding", [0, 3])
def test_random_shift_is_pad_and_crop_with_one_shift_per_sample(padding):
    torch.manual_seed(0)
    images = torch.rand(16, 6, 10, 12)
    shifted = random_shift(images, padding)
    padded = nn.functional.pad(images, (padding,) * 4, mode="replicate")
    offsets = set()
    for before, after in zip(padded, shifted, strict=True):
        crops = {
            (y, x): before[:, y : y + 10, x : x + 12] for y in range(2 * padding + 1) for x in range(2 * padding + 1)
        }
        hits = [offset for offset, crop in crops.items() if torch.equal(crop, after)]
        assert len(hits) == 1
        offsets.add(hits[0])
    assert len(offsets) > (1 if padding else 0)


def test_scaling_averages_areas():
    levels = torch.randint(0, 256, (2, 3, 8, 8), dtype=torch.uint8)
    images = levels.float() / 255
    areas = images.unfold(2, 2, 2).unfold(3, 2, 2).mean((-1, -2))
    torch.testing.assert_close(scale_images(images, (4, 4)), areas, rtol=0, atol=0.5 / 255 + 1e-6)
    # Bytes and floats, whichever way they lie in memory, come out as the same levels.
    expected = scale_images(levels, (4, 4)).float() / 255
    for laid_out in (images, images.contiguous(memory_format=torch.channels_last)):
        assert torch.equal(scale_images(laid_out, (4, 4)), expected)
    assert torch.equal(scale_images(images, (8, 8)), images)


def test_every_row_is_run_by_its_own_skill():
    config = paper_config(encoder="conv", norm="group", image_size=32, conv_channels=[8, 8], n_skills=3)
    library = SkillLibrary(config).eval()
    skill = torch.tensor([2, 0, 2, 1, 0])
    images, subgoal, proprio = torch.rand(5, 6, 32, 32), torch.rand(5, 32), torch.rand(5, 17)
    actions = library(skill, images, subgoal, proprio)
    codes = library.encode_goals(skill, images[:, :3])
    for row, k in enumerate(skill.tolist()):
        one = slice(row, row + 1)
        torch.testing.assert_close(actions[one], library.skills[k](images[one], subgoal[one], proprio[one]))
        torch.testing.assert_close(codes[one], library.skills[k].subgoal_encoder(images[one, :3]))


def test_subgoal_targets_use_running_statistics_and_leave_them_alone():
    config = paper_config(encoder="conv", norm="batch", image_size=32, conv_channels=[8, 8])
    library = SkillLibrary(config).train()
    skill, goals = torch.zeros(4, dtype=torch.int64), torch.rand(4, 3, 32, 32)
    library.encode_goals(skill, goals)
    before = {k: v.clone() for k, v in library.state_dict().items()}
    targets = library.subgoal_targets(skill, goals)
    assert library.training and not targets.requires_grad
    assert all(torch.equal(v, before[k]) for k, v in library.state_dict().items())
    # In eval mode the other rows of the batch do not matter.
    torch.testing.assert_close(library.subgoal_targets(skill[:1], goals[:1]), targets[:1])
    assert not torch.allclose(library.encode_goals(skill, goals), targets)


def test_meta_losses_learn_separable_skills():
    torch.manual_seed(0)
    config = paper_config(
        encoder="conv", norm="group", image_size=32, conv_channels=[8, 8], n_skills=2, meta_proprioception=False
    )
    meta = meta_controller(config).train()
    optimizer = torch.optim.Adam(meta.parameters(), lr=3e-3)
    skill = torch.arange(8) % 2
    images = torch.zeros(8, 3, 32, 32)
    images[skill == 0, :, :16] = 1
    images[skill == 1, :, 16:] = 1
    subgoal = torch.randn(2, 32)[skill]
    for _ in range(60):
        losses, _ = meta.losses(situation(images), skill, subgoal)
        optimizer.zero_grad()
        (losses.skill_id_loss + losses.subgoal_loss + 1e-4 * losses.kl_loss).mean().backward()
        optimizer.step()
    # A double softmax could not get below ln(1 + 1/e) = 0.31.
    assert losses.skill_id_loss.mean() < 0.05 and losses.skill_id_accuracy.all()
    assert (losses.kl_loss > 0).all()


@pytest.mark.parametrize("norm", ["batch", "group"])
def test_resnets_train_on_a_single_sample(norm):
    config = paper_config(norm=norm, image_size=64, n_skills=1, meta_proprioception=False)
    images, skill = torch.rand(1, 6, 64, 64), torch.zeros(1, dtype=torch.int64)
    library, meta = SkillLibrary(config).train(), meta_controller(config).train()
    subgoal = library.encode_goals(skill, images[:, :3])
    assert library(skill, images, subgoal, torch.rand(1, 17)).shape == (1, 1, 4)
    assert torch.isfinite(meta.losses(situation(images[:, :3]), skill, subgoal.detach())[0].subgoal_loss)
