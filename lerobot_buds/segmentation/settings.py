"""Settings of skill discovery for users: durations in seconds, and presets that follow the paper or the release."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self

from lerobot_buds.core import ConfigError, frames_of_seconds, near_names

from .temporal import Search
from .tree import Feature

if TYPE_CHECKING:
    from .discovery import SkillDiscovery

TREE = "tree"

MAX_SKILLS = 12
"""Most skills that are looked for where no setting says otherwise (ours, measured: docs/segmentation.md)."""


@dataclass(frozen=True)
class DiscoveryConfig:
    """Settings of skill discovery, with durations in seconds so that they hold at any frame rate.

    Durations that are None follow from the demonstrations, see `durations`. The presets have the published ones.
    """

    window_s: float | None = None
    """Length of the tree's bottom elements (seconds); None for a 50th of the median demonstration. Paper: 0.5."""

    max_skills: int | None = None
    """Most skills K_max; too short ones are dissolved. None: `MAX_SKILLS`. Implementation notes: 10 for
    Multitask-Kitchen, 8 for Kitchen, 6 for Tool-Use and Hammer-Place."""

    n_skills: int | Literal["auto"] | None = None
    """If given, exactly this many skills, none dissolved; ``auto`` for the number up to `max_skills` that parts the
    segments best. None is ``auto`` as long as pieces are consolidated, else `max_skills` (paper)."""

    segments_per_episode: int | None = None
    """Temporal segments per demonstration; None for as many as the demonstrations are worth, or, where the tree does
    not merge by lines, twice the skills. Implementation notes: 2."""

    segment_worth: float | None = None
    """Share of what moves in a demonstration that one segment more must explain, where the tree merges by lines. None:
    0.02 where movements are clear, else 0.003 (ours, measured)."""

    cut: str = TREE
    """How demonstrations are cut into temporal segments: by the ``tree`` (paper), or by a baseline, a key of `CUTS`;
    with ``kernel change points`` this is the paper's baseline CP."""

    search: Search = "best_first"
    """How the tree is cut: by ``levels`` (paper), or ``best_first`` for an exact number of segments (ours)."""

    min_segment_s: float | None = None
    """Nodes of the tree up to this long are not split (seconds); None for one window by lines, else two. The paper
    leaves it open."""

    min_skill_s: float | None = None
    """Shortest mean segment of a skill (seconds); None for a 14th of the median demonstration. Released commands: 30
    frames for Kitchen; 35 frames for Hammer-Place, 20 for Multitask-Kitchen."""

    num_keyframes: int = 5
    """Latents that describe a segment. Released code: 5 for the kitchens, 3 for the others."""

    feature: Feature = "line"
    """What segments are merged by in the tree: a straight ``line`` (ours), the ``mean`` over all frames (paper), or
    ``three_frames`` (released code)."""

    length_penalty: float = 4.0
    """Penalty per second of merged length in the tree. Released code: 1/5 per frame; 0 is the paper."""

    relative_penalty: bool = True
    """Takes the penalty in units of the median distance between neighbouring bottom elements. Ours; the released code
    takes it in units of the latents, whose scale is arbitrary."""

    passes: int = 2
    """Times the segments are clustered. Released code: 2; paper: 1."""

    consolidate: bool = True
    """Joins skills that never occur apart and lie on one line (ours)."""

    gamma: float | None = None
    """Width of the clustering's kernel; None for a width taken from the segments (ours). Released code: 0.0025 for all
    tasks but Hammer-Place, 0.0001, on latents of arbitrary scale."""

    seed: int = 0
    """Seed of the clustering. Ours; the release is not seeded."""

    def build(self, fps: float) -> "SkillDiscovery":
        """Makes the estimator for a frame rate (frames per second).

        Raises:
            ConfigError: There is no such `cut`.
        """
        from .cuts import CUTS  # imports scikit-learn, as the next does: settings are read without
        from .discovery import SkillDiscovery

        if self.cut != TREE and self.cut not in CUTS:
            known = near_names(self.cut, (TREE, *CUTS))
            raise ConfigError(f"There is no way {self.cut!r} to cut demonstrations. {known}")

        def frames(seconds: float | None) -> int | None:
            return None if seconds is None else frames_of_seconds(seconds, fps)

        return SkillDiscovery(
            cutter=None if self.cut == TREE else lambda latents: CUTS[self.cut](latents, fps),
            window=frames(self.window_s),
            max_skills=MAX_SKILLS if self.max_skills is None else self.max_skills,
            n_skills=self.n_skills,
            segments_per_episode=self.segments_per_episode,
            segment_worth=self.segment_worth,
            search=self.search,
            min_segment_length=frames(self.min_segment_s),
            min_skill_length=frames(self.min_skill_s),
            num_keyframes=self.num_keyframes,
            feature=self.feature,
            length_penalty=self.length_penalty / fps,
            relative_penalty=self.relative_penalty,
            passes=self.passes,
            consolidate=self.consolidate,
            gamma=self.gamma,
            random_state=self.seed,
        )

    def settled(self, found: "SkillDiscovery", fps: float) -> Self:
        """Makes settings with the number and durations that a discovery worked with, for further demonstrations.

        Args:
            found: A fitted discovery that these settings built.
            fps: Frame rate (frames per second).
        """
        lengths = found.durations_
        return replace(
            self,
            max_skills=found.max_skills,
            window_s=lengths.window / fps,
            min_segment_s=lengths.min_segment_length / fps,
            min_skill_s=lengths.min_skill_length / fps,
            segment_worth=lengths.segment_worth or None,
        )


def preset(name: str, config: DiscoveryConfig) -> DiscoveryConfig:
    """Makes settings follow the paper or the released code wherever they depart from it.

    Task-dependent settings (numbers of skills and keyframes, durations) stay as they are; those that are None become
    the published ones of the kitchens.

    Args:
        name: ``default`` (ours; changes nothing), ``paper`` or ``released``.
        config: The settings to start from.

    Raises:
        ConfigError: There is no such preset.
    """
    if name not in PRESETS:
        raise ConfigError(f"There is no preset {name!r}. {near_names(name, PRESETS)}")
    changes = PRESETS[name]
    published = {} if name == "default" else {n: s for n, s in PUBLISHED.items() if getattr(config, n) is None}
    return replace(config, **published | changes)


PUBLISHED: dict[str, Any] = {"max_skills": 10, "window_s": 0.5, "min_segment_s": 1.0, "min_skill_s": 1.5}
"""Number and durations (seconds) of the presets but the default, where no setting gives others. Implementation notes;
paper; open there, hence ours; and released command for Kitchen."""


PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": {"feature": "mean", "search": "levels", "length_penalty": 0.0, "passes": 1, "consolidate": False},
    # Its search has no minimum, and its kernel width is that of all tasks but Hammer-Place.
    "released": {
        "feature": "three_frames",
        "search": "levels",
        "consolidate": False,
        "length_penalty": 4.0,
        "relative_penalty": False,
        "passes": 2,
        "gamma": 0.05**2,
        "min_segment_s": 0.0,
    },
}
"""What the presets set; docs/segmentation.md says why."""
