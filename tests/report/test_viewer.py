"""The recording for the rerun viewer holds what it promises, read back by rerun itself."""

import sys
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import rerun
from PIL import Image
from rerun.experimental import RrdReader

from lerobot_buds.core import ConfigError, StorageError
from lerobot_buds.report import viewer, write_recording
from lerobot_buds.report.viewer import COMPONENTS, principal_components


@pytest.fixture(autouse=True)
def strict():
    """Without it, rerun logs what it cannot do and goes on."""
    rerun.set_strict_mode(True)
    yield
    rerun.set_strict_mode(False)


def columns_of(path):
    """What a recording holds: entity -> name of a component -> its values, with the times (seconds) as ``time``."""
    found = {}
    for chunk in RrdReader(path).store().stream():
        batch = chunk.to_record_batch()
        columns = found.setdefault(str(chunk.entity_path).lstrip("/"), {})
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            values = column.cast("int64").to_numpy() / 1e9 if name == "time" else column.to_pylist()
            columns.setdefault(name.rpartition(":")[2], []).extend(values)
    return found


def test_ribbons_by_hand(content, tmp_path):
    named = replace(content, names=("reach", "grasp", "reach"))
    write_recording(tmp_path / "new" / "demo.rrd", named, "me/demo")
    found = columns_of(tmp_path / "new" / "demo.rrd")
    entities = {name for name in found if name.startswith("demonstrations")}
    assert entities == {f"demonstrations/{n:04d}/{kind}" for n in range(3) for kind in ("skill", "true_stage")}
    ribbon = found["demonstrations/0001/skill"]
    assert ribbon["time"] == pytest.approx([0.0, 0.2, 0.6, 0.8])
    assert ribbon["state"] == [["0"], ["2"], ["1"], [""]]
    assert ribbon["labels"] == [["reach", "grasp", "reach"]] and ribbon["values"] == [["0", "1", "2"]]
    assert found["demonstrations/0000/true_stage"]["labels"] == [["open drawer", "close drawer"]]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["demo.rrd"]


def test_what_is_recorded_of_a_dataset(recorded, tmp_path):
    write_recording(tmp_path / "skills.rrd", recorded, "tests/skills")
    found = columns_of(tmp_path / "skills.rrd")
    latents, labels = found["demonstrations/0002/latents"], recorded.labels[2]
    assert len(latents["scalars"]) == len(labels) and len(latents["scalars"][0]) == COMPONENTS
    assert latents["time"][-1] == pytest.approx((len(labels) - 1) / recorded.dataset.fps)
    segments = 1 + int((np.diff(labels) != 0).sum())
    for camera in ("agentview", "eye_in_hand"):
        blobs = found[f"demonstrations/0002/subgoal/{camera}"]["blob"]
        assert len(blobs) == segments
        assert Image.open(BytesIO(bytes(np.ravel(blobs[0]).tolist()))).size == (32, 32)
    assert len(RrdReader(tmp_path / "skills.rrd").blueprints()) == 1


def test_cameras_that_end_alike_stay_apart(content, tmp_path, monkeypatch):
    class Blank:
        cameras = ("observation.images.left.wrist", "observation.images.right.wrist", "observation.image")

        def __init__(self, *_):
            pass

        def image(self, camera, index):
            return Image.new("RGB", (8, 8))

    monkeypatch.setattr(viewer, "Pictures", Blank)
    write_recording(tmp_path / "skills.rrd", content, "me/demo")
    goals = {name.partition("subgoal/")[2] for name in columns_of(tmp_path / "skills.rrd") if "/subgoal/" in name}
    assert goals == {"left.wrist", "right.wrist", "observation.image"}


@pytest.mark.parametrize("share", [0.3, 0.999])
def test_half_a_recording_is_none(content, tmp_path, largest_file, share):
    """Where rerun writes a file itself and the disk is full, it logs that, and goes on."""
    rerun.set_strict_mode(False)  # as people run it
    path = tmp_path / "demo.rrd"
    write_recording(path, content, "me/demo")
    whole = path.read_bytes()
    with largest_file(int(share * len(whole))), pytest.raises(StorageError, match="could not be written"):
        write_recording(path, content, "me/demo")
    assert path.read_bytes() == whole and list(tmp_path.iterdir()) == [path]


def test_components_are_those_of_all_demonstrations():
    rng = np.random.default_rng(0)
    latents = [rng.normal(size=(n, 5)) * [9, 4, 2, 0.1, 0.1] for n in (30, 20)]
    first, second = principal_components(latents)
    assert first.shape == (30, 3) and second.shape == (20, 3)
    assert abs(np.corrcoef(np.concatenate([first, second])[:, 0], np.concatenate(latents)[:, 0])[0, 1]) > 0.99
    assert principal_components([rng.normal(size=(30, 2))])[0].shape == (30, 2)


def test_without_rerun_it_says_what_to_install(content, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ConfigError, match=r"pip install 'rerun-sdk>=0.33,<0.34'"):
        write_recording(tmp_path / "demo.rrd", content, "me/demo")
    assert not list(tmp_path.iterdir())
