"""The whole chain over the Hub, every part in a process and a home of its own that has never seen the others' files."""

import json
from pathlib import Path

import pytest

from lerobot_buds.core import SEGMENTATION_FILE, SKILL_ID, SUBGOAL_INDEX, read_json

pytestmark = pytest.mark.slow

RUN = """
import json, runpy, sys
from importlib import import_module

for module, *arguments in json.loads(sys.argv[1]):
    sys.argv[1:] = arguments
    import_module(module).main()
"""
SEGMENT, SHARE, JOIN = (f"lerobot_buds.cli.{name}" for name in ("segment", "share", "join"))
TRAIN, EVALUATE = "lerobot.scripts.lerobot_train", "lerobot.scripts.lerobot_eval"
PUSH_SOURCE = """
import sys
from lerobot.datasets import LeRobotDataset
LeRobotDataset(sys.argv[1], root=sys.argv[2]).push_to_hub()
"""
SMALL = [
    *("--representation.image_size=32", "--representation.steps=10", "--representation.batch_size=32"),
    *("--representation.device=cpu", "--discovery.max_skills=3"),
]


def train(dataset: str, policy: str, folder: Path, *options: str) -> list[str]:
    return [
        TRAIN,
        *("--policy.type=buds", "--policy.device=cpu", "--policy.encoder=conv", "--policy.norm=group"),
        *("--policy.conv_channels=[8, 8]", "--policy.keypoints=8", "--policy.head_widths=[32]"),
        *(f"--policy.repo_id={policy}", "--policy.push_to_hub=true", "--policy.subgoal_space=latent"),
        *(f"--dataset.repo_id={dataset}", f"--output_dir={folder}", "--batch_size=16", "--num_workers=0"),
        *("--steps=10", "--save_checkpoint=false", "--log_freq=10", *options),
    ]


def evaluate(policy: str, folder: Path) -> list[str]:
    return [
        EVALUATE,
        *(f"--policy.path={policy}", "--policy.device=cpu", "--env.type=robosuite", "--env.image_size=32"),
        *("--env.render_profile=fastest", "--env.episode_length=3", "--eval.n_episodes=1", "--eval.batch_size=1"),
        *("--eval.use_async_envs=false", f"--output_dir={folder}"),
    ]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sharing")


@pytest.fixture(scope="module")
def do(hub, place: Path):
    """Runs commands one after the other in a fresh process; its home is new unless it is named."""

    def run(home: str, *commands: list[str], code: str = RUN) -> str:
        arguments = [json.dumps(commands)] if code == RUN else commands[0]
        folder = place / home
        done = hub.run(code, *arguments, HF_HOME=str(folder), HF_LEROBOT_HOME=str(folder / "lerobot"))
        assert done.returncode == 0, done.stderr[-3000:]
        return done.stdout

    return run


@pytest.fixture(scope="module")
def shared(hub, do, demonstrations: Path, place: Path) -> dict[str, str]:
    """Repositories of a segmented dataset and of its labels alone, and the commit of their source."""
    do("author", ["her/demos", str(demonstrations)], code=PUSH_SOURCE)
    skills = place / "skills"
    do(
        "me",
        [
            *(SEGMENT, "--repo_id=her/demos", "--output_repo_id=me/skills", f"--output_root={skills}"),
            *(*SMALL, f"--work_dir={place / 'work'}", "--push_to_hub=true"),
        ],
        [SHARE, f"--root={skills}", "--repo_id=me/labels", "--labels_only=true", f"--output_root={place / 'labels'}"],
    )
    commit = json.loads(hub.read("api/datasets/her/demos/revision/main"))["sha"]
    return {"dataset": "me/skills", "labels": "me/labels", "commit": commit}


@pytest.fixture(scope="module")
def trained(do, shared, place: Path) -> Path:
    """Trains on the segmented dataset by its name alone, and on the joined labels; pushes both; evaluates both."""
    do("stranger", train(shared["dataset"], "me/policy", place / "train"))
    joined = place / "joined"
    do(
        "other",
        [JOIN, f"--repo_id={shared['labels']}", "--output_repo_id=other/joined", f"--output_root={joined}"],
        train("other/joined", "other/policy", place / "train_joined", f"--dataset.root={joined}"),
    )
    do("user", evaluate("me/policy", place / "eval"), evaluate("other/policy", place / "eval_joined"))
    return place


def test_a_policy_is_trained_and_evaluated_from_the_hub_alone(trained: Path):
    for name in ("eval", "eval_joined"):
        assert read_json(trained / name / "eval_info.json")["overall"]["n_episodes"] == 1


def test_joined_labels_are_those_that_were_shared(trained: Path):
    names = {"data/chunk-000/file-000.parquet", SEGMENTATION_FILE, "meta/info.json", "meta/stats.json"}
    for name in names:
        assert (trained / "joined" / name).read_bytes() == (trained / "skills" / name).read_bytes(), name
    assert {SKILL_ID, SUBGOAL_INDEX} <= set(read_json(trained / "joined/meta/info.json")["features"])


def test_parents_are_named_by_repository_commit_and_hash(hub, shared, trained: Path):
    record = read_json(trained / "skills" / SEGMENTATION_FILE)
    assert record["source"]["repo_id"] == "her/demos" and record["source"]["commit"] == shared["commit"]
    assert len(record["source"]["content"]) == 4
    network = read_json(trained / "skills/meta/buds/representation/representation.json")
    assert network["trained_on"]["commit"] == shared["commit"]
    config = json.loads(hub.read("me/policy/resolve/main/config.json"))
    parent = config["parents"]["dataset"]
    assert parent["repo_id"] == "me/skills" and parent["content"] == network["trained_on"]["content"]
    assert parent["commit"] in hub.read("me/policy/resolve/main/README.md").decode()


def test_cards_survive_the_pushes_of_lerobot(hub, shared, trained: Path):
    dataset = hub.read("datasets/me/skills/resolve/main/README.md").decode()
    assert "created using [LeRobot]" in dataset and "number of skills K" in dataset and shared["commit"] in dataset
    assert "meta/buds/timeline.png" in dataset
    policy = hub.read("me/policy/resolve/main/README.md").decode()
    assert "# A policy of skills" in policy and "# Model Card for buds" in policy
    labels = hub.read("datasets/me/labels/resolve/main/README.md").decode()
    assert "lerobot-buds-join" in labels and "lerobot-train" not in labels
