"""Demonstrations at the edge of what can be segmented: very short, alone, without any change, in the dark."""

import logging

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lerobot_buds.cli.segment import segment
from lerobot_buds.core import ACTION, STATE
from lerobot_buds.representation import Representation, encode_dataset
from lerobot_buds.segmentation import load_labels

pytestmark = pytest.mark.slow

FRONT = "observation.images.front"
WINDOW = 5  # frames: a quarter of a second at 20 frames per second


def test_demonstrations_of_a_few_frames_are_one_segment_each(make_dataset, settings, tmp_path):
    lengths = (1, 2, WINDOW - 1, WINDOW, 2 * WINDOW - 1)
    source = make_dataset(tmp_path / "source", lengths=lengths)
    record = segment(settings(source, tmp_path, discovery={"window_s": WINDOW / 20}))
    assert [[(s.start, s.end) for s in episode.segments] for episode in record.episodes] == [[(0, n)] for n in lengths]
    assert load_labels(tmp_path / "skills")[2].tolist()[:3] == [0, 2, 2]  # the last frame is its own subgoal


def test_a_single_demonstration(make_dataset, settings, tmp_path):
    source = make_dataset(tmp_path / "source", lengths=(60,))
    record = segment(settings(source, tmp_path))
    assert len(record.episodes) == 1 and record.n_skills >= 1


def test_one_skill_covers_everything(make_dataset, settings, tmp_path):
    source = make_dataset(tmp_path / "source", cameras={})
    record = segment(settings(source, tmp_path, discovery={"n_skills": 1}))
    assert [labels.tolist() for labels in record.labels] == [[0] * 30, [0] * 25]


def test_skills_that_are_all_too_short_leave_one(make_dataset, settings, tmp_path):
    source = make_dataset(tmp_path / "source", cameras={})
    record = segment(settings(source, tmp_path, discovery={"min_skill_s": 60.0}))
    assert record.n_skills == 1 and sum(map(len, record.labels)) == 55


def test_constant_dimensions_and_black_cameras_are_named_and_survived(
    make_dataset, settings, tmp_path, caplog: pytest.LogCaptureFixture
):
    source = make_dataset(tmp_path / "source")
    data = next((source / "data").rglob("*.parquet"))
    frames = pq.read_table(data).to_pydict()
    schema = pq.read_schema(data)
    frames[STATE] = [[0.5, *row[1:]] for row in frames[STATE]]
    frames[ACTION] = [[0.0, 0.0] for _ in frames[ACTION]]
    frames[FRONT] = [{"bytes": black_png(), "path": None} for _ in frames[FRONT]]
    pq.write_table(pa.Table.from_pydict(frames, schema=schema), data)
    with caplog.at_level(logging.WARNING):
        record = segment(settings(source, tmp_path, representation={"proprioception": ["*"]}))
    for said in (
        f"{STATE!r} dimension 0 ('joint_1.pos') is constant",
        f"{ACTION!r} dimension 1 ('y') is constant",
        f"camera {FRONT!r} is black",
    ):
        assert said in caplog.text
    assert sum(map(len, record.labels)) == 55
    latents = encode_dataset(source, Representation.load(tmp_path / "work/representation"))
    assert np.isfinite(np.concatenate(latents)).all()


def black_png() -> bytes:
    from io import BytesIO

    from PIL import Image

    buffer = BytesIO()
    Image.new("RGB", (32, 32)).save(buffer, "PNG")
    return buffer.getvalue()
