"""Representations on the Hub: pushed, pulled, taken from the cache, and one sentence where that cannot be."""

import json
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PREPARE = """
import json, sys
from pathlib import Path
from lerobot_buds.core import CheckpointError
from lerobot_buds.data import hub
from lerobot_buds.representation import Modalities, Representation, RepresentationConfig

hub.PAUSES_S = (0.1, 0.1)

def outcome(name, revision=None):
    try:
        return Representation.from_pretrained(name, revision).hash
    except CheckpointError as error:
        return str(error)
"""
PUSH = """
modalities = Modalities({"observation.images.front": (32, 32)}, ("x", "y"), (1,))
losses = [{"step": 5 * i, "training/loss": 3.0, "validation/loss": v} for i, v in ((1, 2.5), (2, 2.25), (3, 4.5))]
config = RepresentationConfig(image_size=16, latent_dim=4, device="cpu")
blank = Representation.untrained(modalities, config)
mine = Representation(blank.network, modalities, config, "key", losses)
addresses = [mine.push_to_hub(name) for name in ("me/mine", "me/mine", "flaky/mine")]
try:
    mine.push_to_hub("status-403/mine")
except CheckpointError as error:
    print(json.dumps({"hash": mine.hash, "addresses": addresses, "refused": str(error)}))
"""
PULL = """
print(json.dumps([outcome(*asked) for asked in json.loads(sys.argv[1])]))
"""


def answers(run) -> object:
    assert run.returncode == 0, run.stderr[-3000:]
    return json.loads(run.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def pushed(hub) -> dict:
    done = answers(hub.run(PREPARE + PUSH))
    hub.put("models/me/mine/evil.pth", b"a pickle")
    hub.put("models/me/mine/../../../representation.json", b"{}")
    hub.put("models/me/empty/notes.txt", b"nothing of ours")
    return done


def test_what_is_pushed_is_two_files_and_a_card(hub, pushed):
    assert pushed["addresses"] == [f"{hub.address}/{name}" for name in ("me/mine", "me/mine", "flaky/mine")]
    entries = json.loads(hub.read("api/models/flaky/mine/tree/main"))
    assert {e["path"] for e in entries} == {"README.md", "representation.json", "representation.safetensors"}
    card = hub.read("me/mine/resolve/main/README.md").decode()
    assert "pipeline_tag: robotics" in card and "- buds" in card
    assert "| observation.images.front | 32 x 32 pixels |" in card and "| observation.state | y |" in card
    assert "Kept at step 10 of 15." in card and "| loss | 3 | 2.25 |" in card
    assert "--representation_path=me/mine" in card


def test_what_is_pulled_is_what_was_pushed_and_nothing_else(hub, pushed):
    """Also where the Hub fails at first, and from the cache where it is out of reach."""
    asked = [["me/mine"], ["flaky/mine"], ["me/mine", "main"]]
    assert answers(hub.run(PREPARE + PULL, json.dumps(asked))) == 3 * [pushed["hash"]]
    cached = {path.name for path in (hub.home / "hub/models--me--mine/snapshots").rglob("*") if not path.is_dir()}
    assert cached == {"representation.json", "representation.safetensors"}
    assert not list(hub.home.parent.glob("*.json"))
    offline = answers(hub.run(PREPARE + PULL, json.dumps([["me/mine"], ["me/other"]]), HF_HUB_OFFLINE="1"))
    assert offline[0] == pushed["hash"]
    assert "'me/other' is not on this machine and the Hub cannot be reached" in offline[1]


def test_what_cannot_be_had_is_said_in_one_sentence(hub, pushed, tmp_path: Path):
    expected = {
        ("me/absent",): "nor a repository of the Hub that may be used from here (status 404)",
        ("status-401/mine",): "(status 401): check the name, or log in",
        ("status-403/mine",): "(status 403): check the name, or log in",
        ("status-503/mine",): "the Hub answered with status 503",
        ("me/mine", "v9"): "'me/mine' has no revision 'v9'",
        ("me/empty",): "holds no whole representation",
        ("outputs/my representation",): "neither a folder on this machine nor the name of a repository",
    }
    said = answers(hub.run(PREPARE + PULL, json.dumps(list(expected)), HF_HOME=str(tmp_path)))
    assert (
        pushed["refused"].startswith("'status-403/mine' is no repository that may be")
        and "hf auth login" in pushed["refused"]
    )
    for sentence, words in zip(said, expected.values(), strict=True):
        assert words in sentence and "\n" not in sentence
