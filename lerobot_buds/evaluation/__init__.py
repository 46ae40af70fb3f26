"""Scores: agreement of segmentations, distances of paths; rollouts, what they decide and where they fail."""

from .agreement import Agreement, agreement, label_distance, matched_boundaries
from .checkpoint import Checkpoint, load_checkpoint
from .comparison import METHODS, Demonstrations, Result, compare
from .comparison_report import comparison_rows, comparison_table, draw_comparison
from .episodes import Decider, EpisodeRecorder, run_episodes
from .guide import META_CONTROLLER, SKILL_SOURCES, STAGES, SUBGOAL_SOURCES, Guide
from .insight import FAILURE_WINDOW_S, failures_of, summarise, summary_table
from .matched import MatchedScores, confusion, match_labels, matched_scores
from .neighbors import NEIGHBORS
from .paths import warped_distances
from .ribbon import draw_ribbons
from .rollouts import SuccessRate, read_success_rate, success_rate
from .trace import Decision, Episode, RolloutRecord, StageProgress
from .video import episode_frames, write_video

__all__ = [
    "FAILURE_WINDOW_S",
    "META_CONTROLLER",
    "METHODS",
    "NEIGHBORS",
    "SKILL_SOURCES",
    "STAGES",
    "SUBGOAL_SOURCES",
    "Agreement",
    "Checkpoint",
    "Decider",
    "Decision",
    "Demonstrations",
    "Episode",
    "EpisodeRecorder",
    "Guide",
    "MatchedScores",
    "Result",
    "RolloutRecord",
    "StageProgress",
    "SuccessRate",
    "agreement",
    "compare",
    "comparison_rows",
    "comparison_table",
    "confusion",
    "draw_comparison",
    "draw_ribbons",
    "episode_frames",
    "failures_of",
    "label_distance",
    "load_checkpoint",
    "match_labels",
    "matched_boundaries",
    "matched_scores",
    "read_success_rate",
    "run_episodes",
    "success_rate",
    "summarise",
    "summary_table",
    "warped_distances",
    "write_video",
]
