from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from lerobot_buds.core import DatasetError
from lerobot_buds.segmentation import draw_timeline


def test_the_picture_shows_skills_and_stages(tmp_path: Path) -> None:
    labels = [np.repeat([0, 1], [30, 50]), np.repeat([1], 40)]
    stages = [np.repeat([0, 1, 2], [30, 20, 30]), np.repeat([2], 40)]
    draw_timeline(tmp_path / "plain.png", labels, 20)
    draw_timeline(tmp_path / "stages.png", labels, 20, stages)
    plain, with_stages = imread(tmp_path / "plain.png")[..., :3], imread(tmp_path / "stages.png")[..., :3]
    blue, grey = np.array([31, 119, 180]) / 255, np.ptp(with_stages, axis=-1) < 0.01
    assert (np.abs(plain - blue).max(axis=-1) < 0.01).mean() > 0.03
    assert (np.abs(with_stages - blue).max(axis=-1) < 0.01).mean() > 0.02
    dark = grey & (with_stages.mean(axis=-1) < 0.85) & (with_stages.mean(axis=-1) > 0.1)
    assert dark.mean() > 0.02
    assert sorted(p.name for p in tmp_path.iterdir()) == ["plain.png", "stages.png"]


def test_the_same_labels_draw_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_timeline(tmp_path / name, [np.repeat(np.arange(25), 4)], 20)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_skills_are_called_by_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    legends: list[list[str]] = []
    legend = Figure.legend

    def noted(self: Figure, handles: list, **options: object) -> object:
        legends.append([handle.get_label() for handle in handles])
        return legend(self, handles=handles, **options)

    monkeypatch.setattr(Figure, "legend", noted)
    labels = [np.repeat([0, 1, 2, 3], 10)]
    names = ["grasp the cup", "skill 1: 3.1 s, gripper closes", "costs $5 or $\\frac{", "long " * 20]
    draw_timeline(tmp_path / "named.png", labels, 20, names=names)
    draw_timeline(tmp_path / "plain.png", labels, 20)
    assert legends[0][:3] == ["skill 0: grasp the cup", names[1], f"skill 2: {names[2]}"]
    assert len(legends[0][3]) <= 50 and legends[0][3].endswith(" ...")
    assert legends[1] == ["skill 0", "skill 1", "skill 2", "skill 3"]


def test_other_demonstrations_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="differ"):
        draw_timeline(tmp_path / "a.png", [np.zeros(5, dtype=int)], 20, [np.zeros(6, dtype=int)])
    assert not list(tmp_path.iterdir())
