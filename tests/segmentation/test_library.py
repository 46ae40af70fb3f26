from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score

from lerobot_buds.core import EXEMPLARS_FILE, SegmentationError
from lerobot_buds.segmentation import SkillDiscovery, SkillLibrary, read_library, write_library


def discover(latents: list[np.ndarray]) -> tuple[SkillDiscovery, SkillLibrary]:
    found = SkillDiscovery(max_skills=4, min_skill_length=15, num_keyframes=3).fit(latents)
    library = SkillLibrary.of(latents, found.temporal_segments_, found.labels_, found.n_skills_, 3)
    return found, library


@pytest.fixture(scope="module")
def stages(demonstrations: Callable[..., tuple]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return demonstrations(count=16, stages=4, seed=5)


def test_its_own_demonstrations_keep_their_skills(stages: tuple) -> None:
    latents, _ = stages
    found, library = discover(latents)
    labels = library.label(latents, found.temporal_segments_)
    assert [e.tolist() for e in labels] == [e.tolist() for e in found.labels_]


@pytest.mark.parametrize("grow", [False, True])
def test_new_demonstrations_of_known_skills_get_their_numbers(stages: tuple, grow: bool) -> None:
    latents, truth = stages
    found, library = discover(latents[:8])
    labels = library.label(latents[8:], found.cut(latents[8:]), grow=grow, min_length=15)
    assert max(e.max() for e in labels) < library.n_skills
    known = {int(t): int(k) for t, k in zip(truth[0], found.labels_[0], strict=True)}
    expected = [np.vectorize(known.__getitem__)(episode) for episode in truth[8:]]
    assert np.mean(np.concatenate(labels) == np.concatenate(expected)) > 0.9


def test_only_growing_opens_a_skill_for_a_stage_never_seen(stages: tuple) -> None:
    latents, truth = stages
    found, library = discover([h[t < 3] for h, t in zip(latents[:8], truth[:8], strict=True)])
    new, bounds = latents[8:], found.cut(latents[8:])
    plain, grown = (np.concatenate(library.label(new, bounds, grow=g, min_length=30)) for g in (False, True))
    unseen = np.concatenate(truth[8:]) == 3
    assert plain.max() < library.n_skills
    assert grown.max() == library.n_skills  # one more
    assert np.mean((grown == library.n_skills) == unseen) > 0.9
    assert adjusted_rand_score(np.concatenate(truth[8:]), grown) > adjusted_rand_score(np.concatenate(truth[8:]), plain)


def test_the_order_of_the_demonstrations_does_not_matter(stages: tuple) -> None:
    latents, truth = stages
    found, library = discover([h[t < 3] for h, t in zip(latents[:8], truth[:8], strict=True)])
    new = latents[8:]
    labels = library.label(new, found.cut(new), grow=True)
    backwards = library.label(new[::-1], found.cut(new[::-1]), grow=True)[::-1]
    assert adjusted_rand_score(np.concatenate(labels), np.concatenate(backwards)) == 1.0
    old = np.concatenate(labels) < library.n_skills
    np.testing.assert_array_equal(np.concatenate(labels)[old], np.concatenate(backwards)[old])


def test_nothing_is_far_from_a_single_demonstration(stages: tuple) -> None:
    latents, _ = stages
    found, library = discover(latents[:1])
    assert np.isinf(library.reach)
    labels = library.label(latents[1:3], found.cut(latents[1:3]), grow=True)
    assert max(e.max() for e in labels) < library.n_skills


def test_the_file_holds_the_library(stages: tuple, tmp_path: Path) -> None:
    _, library = discover(stages[0][:4])
    library = replace(library, features=library.features.astype(np.float32).astype(np.float64))
    first = write_library(tmp_path, library)
    read = read_library(tmp_path)
    for name in ("features", "skills", "episodes"):
        np.testing.assert_array_equal(getattr(read, name), getattr(library, name))
    assert (read.n_skills, read.num_keyframes) == (library.n_skills, 3)
    assert write_library(tmp_path, read) == first


@pytest.mark.parametrize("damage", [b"", b"\xff" * 100, None])
def test_a_damaged_or_missing_file_is_refused(stages: tuple, tmp_path: Path, damage: bytes | None) -> None:
    write_library(tmp_path, discover(stages[0][:4])[1])
    path = tmp_path / EXEMPLARS_FILE
    if damage is None:
        path.unlink()
    else:
        path.write_bytes(damage)
    with pytest.raises(SegmentationError, match=r"exemplars\.safetensors holds no exemplars"):
        read_library(tmp_path)


def test_other_latents_are_refused(stages: tuple) -> None:
    found, library = discover(stages[0][:4])
    with pytest.raises(SegmentationError, match="5 dimensions, those of the library's exemplars 8"):
        library.label([h[:, :5] for h in stages[0]], found.cut(stages[0]))
