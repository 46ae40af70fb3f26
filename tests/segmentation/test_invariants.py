"""What holds for every segmentation: all frames are covered, and neither order nor axes of the latents matter."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lerobot_buds.core import SegmentationError, segments_of
from lerobot_buds.segmentation import SkillDiscovery

KINDS = ("walk", "noise", "stages", "still", "two points", "an outlier")

# Ties and rounding are decided by a seed's data: the same examples on every run.
examples = settings(max_examples=30, derandomize=True)


def demonstrations(kind: str, lengths: list[int], dims: int, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    places = 3 * rng.normal(size=(4, dims))

    def one(total: int) -> np.ndarray:
        noise = rng.normal(size=(total, dims))
        stages = np.sort(rng.integers(0, 4, total))
        still = np.full((total, dims), 0.1)
        outlier = still.copy()
        outlier[total // 2 :] = 1e6
        choices = {
            "walk": noise.cumsum(axis=0),
            "noise": noise,
            "stages": places[stages] + 0.5 * noise,
            "still": still,
            "two points": places[stages // 2],
            "an outlier": outlier + 1e-3 * noise,
        }
        return choices[kind]

    return [one(total) for total in lengths]


@st.composite
def sets(draw, kinds=KINDS):
    lengths = draw(st.lists(st.integers(0, 130), min_size=1, max_size=6).filter(any))
    return demonstrations(draw(st.sampled_from(kinds)), lengths, draw(st.integers(1, 8)), draw(st.integers(0, 10_000)))


discoveries = st.builds(
    SkillDiscovery,
    window=st.none() | st.integers(1, 12),
    max_skills=st.integers(1, 9),
    min_skill_length=st.integers(0, 80),
    num_keyframes=st.integers(2, 5),
    feature=st.sampled_from(["line", "mean", "three_frames"]),
    search=st.sampled_from(["levels", "best_first"]),
    consolidate=st.booleans(),
    passes=st.integers(1, 3),
    random_state=st.integers(0, 3),
)


@examples
@given(sets(), discoveries)
def test_a_segmentation_is_a_partition(latents, discovery):
    found = discovery.fit(latents)
    assert [len(labels) for labels in found.labels_] == [len(h) for h in latents]
    for labels, segments in zip(found.labels_, found.segments_, strict=True):
        assert [t for s in segments for t in range(s.start, s.end)] == list(range(len(labels)))
        assert segments == segments_of(labels)
    assert set(np.concatenate(found.labels_).tolist()) == set(range(found.n_skills_))
    assert 1 <= found.n_skills_ <= discovery.max_skills


@examples
@given(sets(), discoveries, st.integers(1, 12))
def test_a_number_of_skills_is_kept_or_refused(latents, discovery, n_skills):
    try:
        found = discovery.set_params(n_skills=n_skills).fit(latents)
    except SegmentationError as error:
        assert f"n_skills = {n_skills} skills were asked for" in str(error) and "Lower n_skills" in str(error)
    else:
        assert set(np.concatenate(found.labels_).tolist()) == set(range(n_skills))


@examples
@given(sets(("walk", "noise", "stages")), discoveries, st.randoms(use_true_random=False))
def test_the_order_of_the_demonstrations_changes_names_only(latents, discovery, random):
    order = random.sample(range(len(latents)), len(latents))
    there = discovery.fit(latents).labels_
    back = discovery.fit([latents[i] for i in order]).labels_
    pairs = set(zip(np.concatenate([there[i] for i in order]).tolist(), np.concatenate(back).tolist(), strict=True))
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})  # a renaming


@examples
@given(sets(("walk", "noise", "stages")), discoveries, st.integers(0, 99))
def test_a_rotated_shifted_latent_space_changes_nothing(latents, discovery, seed):
    rng, dims = np.random.default_rng(seed), latents[0].shape[1]
    rotation, offset = np.linalg.qr(rng.normal(size=(dims, dims)))[0], rng.normal(size=dims)
    there = discovery.fit(latents).labels_
    turned = discovery.fit([h @ rotation + offset for h in latents]).labels_
    assert np.concatenate(there).tolist() == np.concatenate(turned).tolist()


def test_a_stretched_latent_space_is_another():
    """What the test above can see: the result does depend on the latents."""
    latents = demonstrations("noise", [90, 80], 2, 0)
    there, stretched = (
        SkillDiscovery(min_skill_length=0).fit([h * [1.0, along] for h in latents]).labels_ for along in (1.0, 40.0)
    )
    assert np.concatenate(there).tolist() != np.concatenate(stretched).tolist()
