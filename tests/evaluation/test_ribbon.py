"""The pictures of rollouts: the right colours at the right places, and video that plays."""

import av
import numpy as np
import pytest
from matplotlib.image import imread

from lerobot_buds.core import Segment
from lerobot_buds.evaluation.ribbon import draw_ribbons
from lerobot_buds.evaluation.trace import Decision, Episode, RolloutRecord
from lerobot_buds.evaluation.video import RibbonBand, episode_frames, write_video

BLUE, ORANGE, GREEN = np.array([31, 119, 180]), np.array([255, 127, 14]), np.array([44, 160, 44])  # tab10's first


def episode(seed: int, lengths: tuple[int, int], success: bool, steps: tuple[int | None, int | None]) -> Episode:
    """Skill 0, then skill 2; skill 1 exists and is not used."""
    first, second = lengths
    skills = (Segment(0, first, 0), Segment(first, first + second, 2))
    return Episode(seed, success, "", skills, (Decision(0, 0, 0, False),), steps)


def record(*episodes: Episode) -> RolloutRecord:
    return RolloutRecord({"failure_window_s": 10.0}, "test/task", ("reach", "grasp"), 20, 3, 5, episodes)


def shares(picture: np.ndarray, *colors: np.ndarray) -> list[float]:
    """How much of a picture has each colour."""
    return [float((np.abs(picture.astype(int) - color).max(axis=-1) < 12).mean()) for color in colors]


def test_the_picture_of_a_run_has_the_colours_of_the_skills_by_their_ids(tmp_path) -> None:
    run = record(episode(1, (40, 40), True, (20, 80)), episode(2, (40, 80), False, (20, None)))
    for name in ("a.png", "b.png"):
        draw_ribbons(tmp_path / name, run)
    picture = (imread(tmp_path / "a.png")[..., :3] * 255).round()
    blue, orange, green = shares(picture, BLUE, ORANGE, GREEN)
    assert green > blue > 0.05 and orange < 0.01  # orange is in the legend alone
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_a_hand_that_wanders_for_ever_does_not_squeeze_the_others(tmp_path) -> None:
    good, lost = episode(1, (40, 40), True, (20, 80)), episode(2, (40, 4000), False, (20, None))
    draw_ribbons(tmp_path / "run.png", record(good, lost))
    blue, _, _ = shares((imread(tmp_path / "run.png")[..., :3] * 255).round(), BLUE, ORANGE, GREEN)
    assert blue > 0.03  # of 40 steps in 4040 there would be a hundredth of the width


def band_rows(picture: np.ndarray) -> np.ndarray:
    """The row through the middle of the ribbon."""
    return picture[41]


def test_the_band_shows_what_was_what_is_and_what_comes() -> None:
    band = RibbonBand(episode(1, (50, 50), True, (25, None)), ("reach", "grasp"), 20, 3, 516)
    start, middle, end = (band_rows(band.at(step)) for step in (0, 75, 100))
    inner = slice(8, 508)
    assert shares(end[inner], BLUE, GREEN) == pytest.approx([0.5, 0.5], abs=0.01)
    assert shares(middle[inner], BLUE, GREEN) == pytest.approx([0.5, 0.25], abs=0.01)
    assert shares(start[inner], BLUE, GREEN) == [0, 0]
    for step, row in ((0, start), (75, middle), (100, end)):
        cursor = np.flatnonzero((row > 230).all(axis=-1))
        assert cursor.tolist() == [7 + 5 * step, 8 + 5 * step]


def test_the_band_names_the_skill_and_the_stage_that_was_done() -> None:
    band = RibbonBand(episode(1, (50, 50), True, (25, None)), ("reach", "grasp"), 20, 3, 516)
    before, after, end = band.at(10), band.at(60), band.at(100)
    chip = (slice(8, 24), slice(10, 20))
    assert shares(before[chip], BLUE) == [1.0] and shares(after[chip], GREEN) == [1.0]
    news = (slice(4, 28), slice(300, 508))
    assert before[news].max() < 60  # nothing is done yet
    assert after[news].max() > 200 and not np.array_equal(after[news], end[news])
    tick = (slice(52, 58), slice(8 + 125 - 4, 8 + 125 + 4))
    assert 100 < before[tick].max() < 200 < after[tick].max()  # dim until the stage is done


@pytest.mark.parametrize("fps", [20, 29.97, 12.5])
def test_an_episodes_video_plays_at_its_pace(tmp_path, fps: float) -> None:
    pictures = [np.full((9, 18, 3), 10 * step, dtype=np.uint8) for step in range(13)]
    run = episode(1, (6, 6), False, (None, None))
    frames = list(episode_frames(run, pictures, ("reach", "grasp"), fps, 3))
    assert {frame.shape for frame in frames} == {(9 * 29 // 2 * 2 + 72, 18 * 29, 3)}
    write_video(tmp_path / "deep/video.mp4", iter(frames), fps)
    with av.open(str(tmp_path / "deep/video.mp4")) as container:
        stream = container.streams.video[0]
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.codec_context.name, float(stream.average_rate)) == ("h264", fps)
    assert len(decoded) == 13 and decoded[0].shape == frames[0].shape
    for step, frame in enumerate(decoded):
        assert abs(float(frame[:200].mean()) - 10 * step) < 6
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["video.mp4"]
