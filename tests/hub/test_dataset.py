"""Datasets from the Hub: fetched, taken from the cache, and one sentence in every command where that cannot be."""

import json
from pathlib import Path

import numpy as np
import pytest

from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE
from lerobot_buds.data.writing import camera_feature, create_dataset, vector_feature, write_episode

pytestmark = pytest.mark.slow

EPISODES, SHAPE, FRONT = 2, (32, 32, 3), f"{IMAGE_PREFIX}front"
PULL = """
import json, sys
from lerobot_buds.core import DatasetError
from lerobot_buds.data import LocalDataset, check_demonstrations, download_dataset, hub

hub.PAUSES_S = (0.1, 0.1)

def outcome(name, revision=None):
    try:
        place = download_dataset(name, revision)
    except DatasetError as error:
        return str(error)
    check_demonstrations(place, side=16)
    return len(LocalDataset(place).episodes)

print(json.dumps([outcome(*asked) for asked in json.loads(sys.argv[1])]))
"""
TAG = """
import sys
from huggingface_hub import HfApi
HfApi().create_tag(sys.argv[1], tag=sys.argv[2], repo_type="dataset")
"""
COMMAND = """
import sys
from importlib import import_module
module, *sys.argv[1:] = sys.argv[1:]
import_module(f"lerobot_buds.cli.{module}").main()
"""


def answers(run) -> list[object]:
    assert run.returncode == 0, run.stderr[-3000:]
    found = json.loads(run.stdout.splitlines()[-1])
    assert isinstance(found, list)
    return found


@pytest.fixture(scope="module")
def published(hub, tmp_path_factory: pytest.TempPathFactory) -> None:
    """A small dataset with the tag that LeRobot looks for, without, and with one of an older format."""
    root, rng = tmp_path_factory.mktemp("hub") / "small", np.random.default_rng(0)
    features = {STATE: vector_feature(["x", "y"]), ACTION: vector_feature(["x"]), FRONT: camera_feature(SHAPE, False)}
    dataset = create_dataset("me/small", root, 10, features)
    for _ in range(EPISODES):
        frames = {STATE: rng.normal(size=(5, 2)), ACTION: rng.normal(size=(5, 1))}
        images = rng.integers(0, 256, (5, *SHAPE), np.uint8)
        write_episode(dataset, {**{n: v.astype(np.float32) for n, v in frames.items()}, FRONT: images}, "move")
    dataset.finalize()
    for name in ("me/tagged", "me/untagged", "me/older", "me/outside", "flaky/data"):
        for path in sorted(path for path in root.rglob("*") if path.is_file()):
            hub.put(f"datasets/{name}/{path.relative_to(root)}", path.read_bytes())
    hub.put("datasets/me/outside/../../../notes.txt", b"")
    for name, version in (("me/tagged", "v3.0"), ("flaky/data", "v3.0"), ("me/older", "v2.1")):
        done = hub.run(TAG, name, version)
        assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.usefixtures("published")
def test_what_is_fetched_is_whole_also_from_a_failing_hub_and_from_the_cache(hub):
    asked = json.dumps([["me/tagged"], ["flaky/data"], ["me/untagged", "main"]])
    assert answers(hub.run(PULL, asked)) == 3 * [EPISODES]
    offline = answers(hub.run(PULL, json.dumps([["me/tagged"], ["me/other"]]), HF_HUB_OFFLINE="1"))
    assert offline[0] == EPISODES
    assert "'me/other' is not on this machine and the Hub cannot be reached: connect, and unset" in str(offline[1])


@pytest.mark.usefixtures("published")
def test_what_cannot_be_had_is_said_in_one_sentence(hub, tmp_path: Path):
    expected = {
        ("me/absent",): "nor a repository of the Hub that may be used from here (status 404): check the name",
        ("status-401/data",): "(status 401): check the name, or log in",
        ("status-503/data",): "the Hub answered with status 503",
        ("me/tagged", "nowhere"): "'me/tagged' has no revision 'nowhere'",
        ("me/tagged", "v9.0"): "'me/tagged' has no revision of format v9.0",
        ("me/untagged",): "has no tag of a version, by which LeRobot chooses: name a revision, such as --revision=main",
        ("me/outside", "main"): "'me/outside' was not fetched: it has a file whose name leads out of it",
        ("me/older",): "'me/older' has no revision of format v3.0 on the Hub: convert it",
        ("my data",): "neither a folder on this machine nor the name of a repository",
    }
    said = answers(hub.run(PULL, json.dumps(list(expected)), HF_HOME=str(tmp_path), HF_LEROBOT_HOME=str(tmp_path)))
    for sentence, words in zip(said, expected.values(), strict=True):
        assert words in str(sentence) and "\n" not in str(sentence)


@pytest.mark.parametrize(("module", "offline"), [("segment", "0"), ("compare", "1")])
def test_a_command_ends_in_one_line_for_a_name_that_does_not_exist(hub, module: str, offline: str, tmp_path: Path):
    options = ["--repo_id=me/tpyo", f"--work_dir={tmp_path}"]
    done = hub.run(COMMAND, module, *options, HF_HUB_OFFLINE=offline)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    line = done.stderr.strip()
    assert line.startswith("error: 'me/tpyo' is ") and ("unset HF_HUB_OFFLINE" in line) == (offline == "1")
