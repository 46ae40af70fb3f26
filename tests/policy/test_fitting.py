import json
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import draccus
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig

from lerobot_buds.core import (
    ACTION,
    EYE_IN_HAND_CAMERA,
    OUR_STATE,
    SEGMENTATION_FILE,
    STATE,
    WORKSPACE_CAMERA,
    CheckpointError,
    ConfigError,
    SegmentationError,
    frames_of_seconds,
)
from lerobot_buds.envs import PROFILES
from lerobot_buds.policy import BudsConfig
from lerobot_buds.policy.fitting import _check_depth, check_observation, choose_state, state_names, task_number


def config_of(**overrides):
    features = {
        "observation.images.front": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 96, 128)),
        "observation.images.wrist": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 96, 128)),
        STATE: PolicyFeature(type=FeatureType.STATE, shape=(3,)),
        "observation.environment_state": PolicyFeature(type=FeatureType.ENV, shape=(2,)),
    }
    return BudsConfig(
        device="cpu",
        **{
            "input_features": features,
            "output_features": {ACTION: PolicyFeature(type=FeatureType.ACTION, shape=(4,))},
            **overrides,
        },
    )


def test_the_dataset_fills_the_open_fields(build, task):
    config = build().config
    assert (config.n_skills, config.fps, config.tasks) == (2, 20, [task])
    assert config.current_dims == [0, 1] and config.history_dims == [2, 3]
    assert config.history_frames == 5 and config.meta_period == 5
    assert config.stacked_cameras == [WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA]
    assert set(config.input_features) == {WORKSPACE_CAMERA, EYE_IN_HAND_CAMERA, STATE}


def test_first_camera_is_the_workspace_where_there_is_no_agent_view():
    config = config_of()
    config.validate_features()
    assert config.stacked_cameras == ["observation.images.front", "observation.images.wrist"]
    assert "observation.environment_state" not in config.input_features


SO101 = ["shoulder_pan.pos", "shoulder_lift.pos", "gripper.pos"]


@pytest.mark.parametrize(
    ("names", "patterns", "current", "history"),
    [
        (SO101, {}, [0, 1, 2], []),  # all of a stranger's robot, whatever they are called
        (["joint_1", "joint_2", "gripper"], {}, [0, 1, 2], []),
        ([], {}, [0, 1, 2], []),
        (SO101, {"history_state": ["*gripper*"]}, [0, 1, 2], [2]),
        (SO101, {"current_state": ["shoulder*"], "history_state": ["gripper.pos"]}, [0, 1], [2]),
        (SO101, {"current_state": []}, [], []),  # empty is what it says
        ([], {"current_state": ["0", "2"]}, [0, 2], []),
        (OUR_STATE, {}, list(range(7)), [7, 8]),  # the paper's
    ],
)
def test_state_dimensions_by_name(names, patterns, current, history, caplog):
    features = {**config_of().input_features, STATE: PolicyFeature(type=FeatureType.STATE, shape=(len(names) or 3,))}
    config = config_of(input_features=features, state_names=list(names), **patterns)
    with caplog.at_level("INFO", logger="lerobot_buds"):
        choose_state(config)
    assert (config.current_dims, config.history_dims) == (current, history)
    unread = [name for d, name in enumerate(names or ["0", "1", "2"]) if d not in {*current, *history}]
    assert f"do not read {unread}" in caplog.text


def test_patterns_that_match_nothing_are_refused():
    with pytest.raises(ConfigError, match=r"current_state: '\*joint\*' matches no dimension.*'shoulder_pan.pos'"):
        choose_state(config_of(state_names=SO101, current_state=["*joint*", "gripper*"]))


def test_state_names_in_all_of_lerobots_spellings():
    def names(value):
        return state_names({STATE: {"shape": (2,), "names": value}})

    assert names(["a", "b"]) == ["a", "b"]
    assert names({"motors": ["a", "b"]}) == ["a", "b"]
    assert names(None) == names(["state"]) == state_names({}) == []


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("encoder", "resnet"),
        ("norm", "layer"),
        ("n_skills", 0),
        ("image_size", 0),
        ("crop_padding", -1),
        ("meta_period_s", 0.0),
        ("kl_weight", -1.0),
        ("conv_channels", []),
        ("fps", 0.0),
        ("action_scaling", "bound"),
    ],
)
def test_impossible_values_are_refused(field, value):
    with pytest.raises(ConfigError, match=field):
        BudsConfig(device="cpu", **{field: value})


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"workspace_camera": "observation.images.frnt"}, "Did you mean 'observation.images.front'"),
        ({"image_size": 112}, "enlarge"),
        ({"image_size": 48}, "at least 64 pixels"),
        ({"output_features": {}}, "action"),
        ({"input_features": {}}, "at least one camera"),
    ],
)
def test_features_that_do_not_fit_are_refused(overrides, message):
    with pytest.raises(ConfigError, match=message):
        config_of(**overrides).validate_features()


@pytest.mark.parametrize(("shape", "depth"), [((1, 96, 128), False), ((4, 96, 128), False), ((3, 96, 128), True)])
def test_images_that_are_not_rgb_are_left_out_by_name_or_refused(shape, depth):
    """Depth maps (of one channel, or declared with three), grey and RGBA images."""
    other = "observation.images.other"

    def settle(**overrides):
        features = {**config_of().input_features, other: PolicyFeature(type=FeatureType.VISUAL, shape=shape)}
        config = config_of(input_features=features, image_size=64, **overrides)
        config.validate_features()
        _check_depth(config, SimpleNamespace(depth_keys=[other] if depth else []))
        return config

    message = r"RGB.*observation.images.other.*cameras='\[observation.images.front, observation.images.wrist\]'"
    with pytest.raises(ConfigError, match=message):
        settle()
    with pytest.raises(ConfigError, match="no RGB camera"):
        settle(cameras=[other])
    config = settle(cameras=["observation.images.wrist"])
    assert config.stacked_cameras == ["observation.images.wrist"] and other not in config.input_features


def test_cameras_are_named_as_they_are():
    with pytest.raises(ConfigError, match=r"Did you mean 'observation\.images\.wrist'"):
        config_of(cameras=["observation.images.wirst"]).validate_features()
    with pytest.raises(ConfigError, match="at least one camera"):
        config_of(cameras=[]).validate_features()


def test_cameras_of_different_shapes_need_an_image_size():
    features = {**config_of().input_features}
    features["observation.images.wrist"] = PolicyFeature(type=FeatureType.VISUAL, shape=(3, 80, 80))
    with pytest.raises(ConfigError, match="image_size"):
        config_of(input_features=features).validate_features()
    config_of(input_features=features, image_size=64).validate_features()


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"n_skills": 3}, "n_skills=3.*has 2"),
        ({"segmentation": "0123"}, "segmentation='0123'.*policy.segmentation=null"),
        ({"fps": 10}, "fps=10.*has 20"),
        ({"state_names": ["a", "b", "c", "d", "e"]}, "state_names.*joint_1"),
        (
            {"input_features": {WORKSPACE_CAMERA: PolicyFeature(type=FeatureType.VISUAL, shape=(3, 64, 64))}},
            r"\(3, 64, 64\).*\(3, 32, 32\)",
        ),
        (
            {"input_features": {"observation.images.top": PolicyFeature(type=FeatureType.VISUAL, shape=(3, 32, 32))}},
            "observation.images.top.*lacks",
        ),
    ],
)
def test_a_dataset_that_does_not_fit_is_refused_with_both_sides(build, overrides, message):
    with pytest.raises(CheckpointError, match=message):
        build(**overrides)


def test_an_unsegmented_dataset_is_refused_before_training(build, meta, tmp_path, monkeypatch):
    monkeypatch.setattr(meta, "root", tmp_path)
    with pytest.raises(SegmentationError, match=json.dumps(SEGMENTATION_FILE)[1:-1]):
        build()


def test_unknown_tasks_are_refused_near_matches_first():
    config = config_of(tasks=["Close the drawer", "Boil the pot"])
    task_number(config, "Boil the pot")
    with pytest.raises(ConfigError, match=r"'Close the drawr'.*Did you mean 'Close the drawer'.*'Boil the pot'"):
        task_number(config, "Close the drawr")
    with pytest.raises(ConfigError, match="''"):
        task_number(config, "")
    task_number(config_of(tasks=["Boil the pot"]), "")
    task_number(config_of(), "anything")


def test_a_dataset_with_an_unknown_task_is_refused(build):
    with pytest.raises(ConfigError, match=r"'Close the drawer'.*Known: 'Open the drawer'"):
        build(tasks=["Open the drawer"])


@pytest.mark.parametrize("settings", [{}, {"meta_controllers": "conditioned"}, {"skills": "flat"}])
def test_only_meta_controllers_of_their_own_take_another_task(build, tmp_path, settings, task):
    known, more = [task, "Boil the pot"], "Open the drawer"
    build(tasks=known, **settings).save_pretrained(tmp_path)
    build(tasks=known, pretrained_path=tmp_path, **settings)
    with pytest.raises(ConfigError, match=r"order of the checkpoint's tasks, \['Close.*', 'Boil the pot'\]"):
        build(tasks=known[::-1], pretrained_path=tmp_path, **settings)
    if not settings:
        tuned = build(tasks=[*known, more], pretrained_path=tmp_path)
        assert len(tuned.model.meta_controllers.controllers) == 3
        return
    library = "skills_path" if "skills" not in settings else "new policy on all tasks\\. "
    with pytest.raises(ConfigError, match=rf"tasks \['Close.*', 'Boil the pot'\]: one network.*{library}"):
        build(tasks=[*known, more], pretrained_path=tmp_path, **settings)


def load(name, *overrides):
    """Parses a policy file the way the console scripts do."""

    @dataclass
    class Run:
        policy: PreTrainedConfig

    file = Path(__file__).parents[2] / "configs/policy" / name
    return draccus.parse(Run, args=[f"--policy=include {file}", *overrides]).policy


def test_the_paper_file_is_the_defaults_without_what_is_ours():
    ours = {"boundary_overlap_s": 0.0, "meta_proprioception": False, "skill_memory": False}
    assert load("buds.yaml", "--policy.device=cpu") == BudsConfig(device="cpu", **ours)


def test_baselines_plan_as_far_ahead_as_what_they_are_compared_with():
    chunks = {(c.chunk_size, c.n_action_steps) for c in map(load, ("buds_improved.yaml", "bc.yaml", "gti.yaml"))}
    assert chunks == {(5, 5)}


def test_the_cpu_preset_is_small_and_takes_overrides():
    config = load("buds_cpu.yaml", "--policy.optimizer_lr=0.5")
    assert (config.encoder, config.norm, config.image_size, config.optimizer_lr) == ("conv", "group", 64, 0.5)
    assert not config.push_to_hub


def test_images_drawn_otherwise_than_the_demonstrations_are_refused():
    config = config_of(render_profile="fast")
    profiles = list(PROFILES)

    def drawn(profile):
        return {"observation.render_profile": torch.tensor([[float(profiles.index(profile))]] * 2)}

    check_observation(config, drawn("fast"))
    check_observation(config, {})
    check_observation(config_of(), drawn("full"))
    with pytest.raises(CheckpointError, match=r"'fast'.*'full'"):
        check_observation(config, drawn("full"))


def test_an_environment_of_another_rate_is_refused():
    check_observation(config_of(fps=20), {"observation.control_rate": torch.tensor([[20.0]])})
    check_observation(config_of(), {"observation.control_rate": torch.tensor([[20.0]])})
    with pytest.raises(CheckpointError, match=r"at 10 frames a second.*at 20 control steps"):
        check_observation(config_of(fps=10), {"observation.control_rate": torch.tensor([[20.0]])})


@pytest.mark.parametrize("fps", [29.97, 12.5])
def test_rates_are_no_integers(fps):
    config = draccus.decode(PreTrainedConfig, {**draccus.encode(config_of(fps=fps), PreTrainedConfig)})
    assert config.fps == fps and config.meta_period == frames_of_seconds(0.25, fps)

    def run_at(rate):
        return check_observation(config, {"observation.control_rate": torch.tensor([[rate]])})

    run_at(fps)  # as float32
    with pytest.raises(CheckpointError, match=f"at {fps} frames.*at 30 control"):
        run_at(30.0)


def test_checkpoints_with_whole_rates_are_read():
    stored = {**draccus.encode(config_of(), PreTrainedConfig), "fps": 20}
    assert draccus.decode(PreTrainedConfig, stored).fps == 20


def test_the_rate_of_a_dataset_is_compared_with_a_tolerance(build, meta, monkeypatch):
    monkeypatch.setattr(meta.info, "fps", 29.97)
    assert build().config.fps == 29.97
    assert build(fps=30000 / 1001).config.fps == 30000 / 1001
    with pytest.raises(CheckpointError, match=r"fps=30.*has 29.97"):
        build(fps=30)
