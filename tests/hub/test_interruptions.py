"""What goes wrong on the way: an interrupted push, hostile files, a Hub that refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE
from lerobot_buds.data.writing import camera_feature, create_dataset, vector_feature, write_episode
from lerobot_buds.segmentation import SegmentationRecord, write_companion, write_segmented_dataset

pytestmark = pytest.mark.slow

CAMERA = f"{IMAGE_PREFIX}front"
COMMAND = """
import sys
from importlib import import_module
module, *sys.argv[1:] = sys.argv[1:]
import_module(f"lerobot_buds.cli.{module}").main()
"""
PUSHES = """
import json, sys
from pathlib import Path
from lerobot_buds.core import DatasetError
from lerobot_buds.data import hub
from lerobot_buds.segmentation import share_dataset

hub.PAUSES_S = (0.1, 0.1)

def outcome(name):
    try:
        return share_dataset(Path(sys.argv[2]), name)
    except DatasetError as error:
        return str(error)

print(json.dumps([outcome(name) for name in json.loads(sys.argv[1])]))
"""
PLAIN_PUSHES = """
import sys
from lerobot.datasets import LeRobotDataset
from lerobot_buds.segmentation import card_kwargs

LeRobotDataset("me/plain", root=sys.argv[1]).push_to_hub()
LeRobotDataset("me/told", root=sys.argv[1]).push_to_hub(**card_kwargs(sys.argv[1], "me/told"))
"""
OUTCOMES = """
import json, sys
from pathlib import Path
from lerobot_buds.core import BudsError
from lerobot_buds.data import hub
from lerobot_buds.evaluation.checkpoint import load_policy

hub.PAUSES_S = (0.1, 0.1)

def outcome(name):
    try:
        load_policy(name, Path(sys.argv[2]), "cpu")
    except BudsError as error:
        return str(error)

print(json.dumps([outcome(name) for name in json.loads(sys.argv[1])]))
"""


@pytest.fixture(scope="module")
def skills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small segmented dataset."""
    folder, rng = tmp_path_factory.mktemp("interrupted"), np.random.default_rng(0)
    features = {STATE: vector_feature(["x"]), ACTION: vector_feature(["x"]), CAMERA: camera_feature((32, 32, 3), False)}
    dataset = create_dataset("her/small", folder / "source", 10, features)
    for _ in range(2):
        frames = {name: rng.normal(size=(8, 1)).astype(np.float32) for name in (STATE, ACTION)}
        write_episode(dataset, {**frames, CAMERA: rng.integers(0, 256, (8, 32, 32, 3), np.uint8)}, "move")
    dataset.finalize()
    labels = [np.repeat([0, 1], [3, 5]), np.repeat([0, 1], [4, 4])]
    record = SegmentationRecord.of_labels(labels, repo_id="her/small", fps=10, horizon=4)
    write_segmented_dataset(folder / "source", folder / "skills", "me/small", record)
    return folder / "skills"


def files_of(hub, name: str) -> dict[str, int]:
    return {entry["path"]: entry["size"] for entry in json.loads(hub.read(f"api/datasets/{name}/tree/main"))}


def refusal(run) -> str:
    """The one line by which a command ends; bars of progress may stand behind it."""
    assert run.returncode == 1 and "Traceback" not in run.stderr
    (line,) = [line for line in run.stderr.splitlines() if line.startswith("error: ")]
    return str(line)


def test_an_interrupted_push_goes_on_with_what_is_missing(hub, skills: Path):
    share = ("share", f"--root={skills}", "--repo_id=me/small")
    hub.limit(1)
    before = hub.received
    cut = hub.run(COMMAND, *share)
    hub.limit(1000)
    assert "'me/small' is no repository that may be written" in refusal(cut)
    first = hub.received - before
    assert first > 0 and files_of(hub, "me/small") == {}
    done = hub.run(COMMAND, *share)
    assert done.returncode == 0, done.stderr[-2000:]
    second = hub.received - before - first
    large = sum(path.stat().st_size for path in skills.rglob("*.parquet"))
    small = sum(path.stat().st_size for path in skills.rglob("*") if path.is_file() and path.suffix != ".parquet")
    card = files_of(hub, "me/small")["README.md"]
    assert second == large - first + small + card  # LeRobot's call sends the folder's card, then its own
    again = hub.run(COMMAND, *share)
    assert again.returncode == 0, again.stderr[-2000:]
    own = (skills / "README.md").stat().st_size
    assert hub.received - before - first - second == own + card


def test_a_push_of_lerobots_own_leaves_our_card_beside_its_own(hub, skills: Path):
    done = hub.run(PLAIN_PUSHES, skills)
    assert done.returncode == 0, done.stderr[-2000:]
    ours = "number of skills K"
    assert ours not in hub.read("datasets/me/plain/resolve/main/README.md").decode()
    assert ours in hub.read("datasets/me/plain/resolve/main/meta/buds/card.md").decode()
    assert ours in hub.read("datasets/me/told/resolve/main/README.md").decode()


def test_a_push_goes_to_a_branch_that_did_not_exist(hub, skills: Path):
    done = hub.run(COMMAND, "share", f"--root={skills}", "--repo_id=me/branched", "--branch=trial")
    assert done.returncode == 0, done.stderr[-2000:]
    assert b"number of skills K" in hub.read("datasets/me/branched/resolve/trial/README.md")
    assert files_of(hub, "me/branched") == {}


def test_a_push_that_cannot_be_ends_in_one_sentence(hub, skills: Path):
    expected = {
        "status-401/x": "log in with 'hf auth login'",
        "status-429/x": "status 429",
        "status-503/x": "not sent twice",
    }
    done = hub.run(PUSHES, json.dumps(list(expected)), skills)
    assert done.returncode == 0, done.stderr[-3000:]
    for said, words in zip(json.loads(done.stdout.splitlines()[-1]), expected.values(), strict=True):
        assert words in said and "\n" not in said
    offline = hub.run(COMMAND, "share", f"--root={skills}", "--repo_id=me/x", HF_HUB_OFFLINE="1")
    assert offline.returncode == 1 and "Traceback" not in offline.stderr
    assert (
        offline.stderr.strip().splitlines()[-1].startswith("error: 'me/x' was not sent, as the Hub cannot be reached")
    )


def test_nothing_but_labels_is_fetched_of_a_companion(hub, skills: Path, tmp_path: Path):
    write_companion(skills, tmp_path / "labels", "me/labels_only")
    for path in sorted(path for path in (tmp_path / "labels").rglob("*") if path.is_file()):
        hub.put(f"datasets/me/labels_only/{path.relative_to(tmp_path / 'labels')}", path.read_bytes())
    hub.put("datasets/me/labels_only/evil.pth", b"a pickle")
    hub.put("datasets/me/labels_only/../../../meta/buds/segmentation.json", b"{}")
    join = ("join", "--repo_id=me/labels_only", f"--source_root={skills.with_name('source')}")
    done = hub.run(COMMAND, *join, f"--output_root={tmp_path / 'joined'}", HF_HOME=str(tmp_path / "home"))
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "joined/meta/buds/segmentation.json").read_bytes() == (
        tmp_path / "labels/meta/buds/segmentation.json"
    ).read_bytes()
    assert not list(tmp_path.rglob("*.pth"))


def test_checkpoints_that_cannot_be_had_are_refused_in_one_sentence(hub, checkpoint: Path, segmented: Path):
    for path in checkpoint.iterdir():
        for name in ("me/good", "me/absurd"):
            hub.put(f"models/{name}/{path.name}", path.read_bytes())
    hub.put("models/me/absurd/model.safetensors", b"\xff" * 8 + b"{}")
    hub.put("models/me/good/evil.pth", b"a pickle")
    hub.put("models/me/outside/../../../config.json", b"{}")
    expected = {
        "me/good": None,
        "me/absurd": "holds no readable weights",
        "me/outside": "whose name leads out of it",
        "me/absent": "(status 404): check the name",
        "status-401/policy": "(status 401): check the name, or log in",
        "status-429/policy": "the Hub answered with status 429",
        "status-503/policy": "the Hub answered with status 503",
    }
    done = hub.run(OUTCOMES, json.dumps(list(expected)), segmented)
    assert done.returncode == 0, done.stderr[-3000:]
    for said, words in zip(json.loads(done.stdout.splitlines()[-1]), expected.values(), strict=True):
        assert said is words is None or (words in said and "\n" not in said), said
    assert not list(hub.home.rglob("*.pth"))
