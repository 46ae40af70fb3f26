"""How a hand moves, in numbers: what people's demonstrations and scripted ones are compared by.

All is computed from the hand's path and the gripper's commands alone, so that any robot's demonstrations can be held
beside any other's. Velocities are central differences over 0.2 s, which leaves out what sensors and tremor add.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from lerobot_buds.core import IntArray, Segment, segments_of

Vec = NDArray[np.float64]

WINDOW_S = 0.2
STILL = 0.01
"""A hand slower than this stands still (m/s)."""

PAUSE_S = 0.3
"""It pauses where it stands still at least this long (s)."""

TURNING = 0.02
"""A reversal counts between motions that are faster than this (m/s)."""

BRIEF_GRIP_S = 1.5
"""A closing that is taken back within this time (s) caught nothing, or not what it should."""

NEAR = 0.05
"""Distance (m) from the place where the gripper next changes, or last did, within which a hand is near contact."""

REVERSING = -0.5
"""Cosine of the angle between before and after, below which a direction reverses: a turn by more than 120 degrees."""

STRETCH_S = 2.0
"""Smoothness is measured in stretches of this length (s), as it depends on the length."""

_HIGHEST_HZ, _LOWEST_SHARE, _PADDING = 10.0, 0.05, 4


@dataclass(frozen=True)
class Movement:
    """How the hand moved in some episodes; rates are a minute of the whole time.

    Attributes:
        speed_p10: Tenth percentile of the speed while the hand moves (m/s).
        speed_p50: Its median.
        speed_p90: Its ninetieth percentile.
        paused: Share of the time in pauses.
        pauses: Pauses a minute.
        corrections: Reversals of the direction a minute, within twice `WINDOW_S`.
        smoothness: Spectral arc length of the speed (Balasubramanian et al. 2015), mean over stretches of `STRETCH_S`
            that are mostly motion; some -1.5 for a single smooth reach, lower the more a motion is made of.
        flips: Changes of the gripper's command an episode.
        brief_grips: Closings an episode that were taken back within `BRIEF_GRIP_S`.
        detour: Length of the path between changes of the gripper over the straight way.
        near: Share of the time within `NEAR` of where the gripper next changes or last did.
        near_speed: Median speed of the moving hand there, over that elsewhere.
    """

    speed_p10: float
    speed_p50: float
    speed_p90: float
    paused: float
    pauses: float
    corrections: float
    smoothness: float
    flips: float
    brief_grips: float
    detour: float
    near: float
    near_speed: float


def measure(episodes: Sequence[tuple[Vec, IntArray]], fps: float) -> Movement:
    """Measures the movement of some episodes, pooled over all of their frames.

    Args:
        episodes: Of each, the hand's path (m), ``(T, 3)``, and ``(T,)`` 1 where the gripper is told to be closed.
        fps: Frames a second of both.
    """
    velocities = [velocity(path, fps) for path, _ in episodes]
    speeds = [_norms(v) for v in velocities]
    pauses = [pauses_in(speed, fps) for speed in speeds]
    grips = [segments_of(closed) for _, closed in episodes]
    near = np.concatenate([near_contact(path, closed) for path, closed in episodes])
    every = np.concatenate(speeds)
    moving = every > STILL
    minutes = len(every) / fps / 60.0
    p10, p50, p90 = np.percentile(every[moving], [10, 50, 90]).tolist()
    smooth = [spectral_arc_length(stretch, fps) for speed in speeds for stretch in moving_stretches(speed, fps)]
    walked, straight = np.sum([ways(path, closed) for path, closed in episodes], axis=0).tolist()
    return Movement(
        speed_p10=p10,
        speed_p50=p50,
        speed_p90=p90,
        paused=sum(end - start for of in pauses for start, end in of) / len(every),
        pauses=sum(map(len, pauses)) / minutes,
        corrections=sum(reversals(v, fps) for v in velocities) / minutes,
        smoothness=float(np.mean(smooth)) if smooth else float("nan"),
        flips=float(np.mean([len(of) - 1 for of in grips])),
        brief_grips=float(np.mean([sum(_is_brief(of, n, fps) for n in range(len(of))) for of in grips])),
        detour=walked / straight if straight else float("nan"),
        near=float(near.mean()),
        near_speed=_median(every[near & moving]) / _median(every[~near & moving]),
    )


def velocity(path: Vec, fps: float) -> Vec:
    """Computes velocities (m/s), ``(T, 3)``, from a path (m), ``(T, 3)``; one-sided at both ends."""
    half = max(round(WINDOW_S * fps / 2), 1)
    frames = np.arange(len(path))
    after, before = np.minimum(frames + half, len(path) - 1), np.maximum(frames - half, 0)
    change: Vec = (path[after] - path[before]) * fps / np.maximum(after - before, 1)[:, None]
    return change


def pauses_in(speed: Vec, fps: float) -> list[tuple[int, int]]:
    """Finds the pauses, half-open in frames, in speeds (m/s), ``(T,)``."""
    still = segments_of((speed < STILL).astype(np.int64))
    return [(s.start, s.end) for s in still if s.label and s.length >= PAUSE_S * fps]


def moving_stretches(speed: Vec, fps: float) -> list[Vec]:
    """Cuts speeds (m/s), ``(T,)``, into stretches of `STRETCH_S`; drops those that stand still for half of it."""
    length = round(STRETCH_S * fps)
    stretches = [speed[start : start + length] for start in range(0, len(speed) - length + 1, length)]
    return [stretch for stretch in stretches if (stretch > STILL).mean() > 0.5]


def reversals(velocities: Vec, fps: float) -> int:
    """Counts how often the direction reverses in velocities (m/s), ``(T, 3)``: one for each stay beyond."""
    half = max(round(WINDOW_S * fps), 1)
    before, after = velocities[: -2 * half], velocities[2 * half :]
    moving = (_norms(before) > TURNING) & (_norms(after) > TURNING)
    cosine = (before * after).sum(axis=1) / np.maximum(_norms(before) * _norms(after), 1e-12)
    back = moving & (cosine < REVERSING)
    return int((np.diff(back.astype(np.int64), prepend=0) == 1).sum())


def spectral_arc_length(speed: Vec, fps: float) -> float:
    """Computes the smoothness of speeds, ``(T,)``: the length of their normalised spectrum's curve, negative.

    Balasubramanian, Melendez-Calderon, Roby-Brami, Burdet 2015: up to 10 Hz, or the last frequency with a twentieth of
    the largest magnitude.
    """
    size = 2 ** (int(np.ceil(np.log2(len(speed)))) + _PADDING)
    magnitude = np.abs(np.fft.rfft(speed, size))
    magnitude /= magnitude.max()
    frequency = np.fft.rfftfreq(size, 1.0 / fps)
    last = int(np.flatnonzero((frequency <= _HIGHEST_HZ) & (magnitude >= _LOWEST_SHARE))[-1]) + 1
    frequency, magnitude = frequency[:last], magnitude[:last]
    if last < 2:
        return 0.0
    return -float(np.hypot(np.diff(frequency) / (frequency[-1] - frequency[0]), np.diff(magnitude)).sum())


def ways(path: Vec, closed: IntArray) -> Vec:
    """Adds up what was walked between changes of the gripper and the straight way (m), shape (2,)."""
    marks = [segment.start for segment in segments_of(closed)] + [len(path) - 1]
    walked = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    straight = np.linalg.norm(np.diff(path[marks], axis=0), axis=1).sum()
    return np.array([walked, straight])


def near_contact(path: Vec, closed: IntArray) -> NDArray[np.bool_]:
    """Tells, ``(T,)``, where the hand is within `NEAR` of a place at which the gripper next changes or last did."""
    near = np.zeros(len(path), dtype=np.bool_)
    segments = segments_of(closed)
    for number, segment in enumerate(segments):
        places = path[[at for at in (segment.start if number else -1, segment.end) if 0 < at < len(path)]]
        stretch = path[segment.start : segment.end]
        away = np.linalg.norm(stretch[:, None] - places[None], axis=2)
        near[segment.start : segment.end] = (away < NEAR).any(axis=1)
    return near


def table(rows: dict[str, tuple[int, Movement]]) -> str:
    """Formats movements as a Markdown table, a row each.

    Args:
        rows: Of each, by its name, the number of episodes and the movement.
    """
    heads = [field.name.replace("_", " ") for field in fields(Movement)]
    lines = [f"| | episodes | {' | '.join(heads)} |", "|---" * (len(heads) + 2) + "|"]
    for name, (episodes, movement) in rows.items():
        cells = [_cell(field.name, getattr(movement, field.name)) for field in fields(Movement)]
        lines.append(f"| {name} | {episodes} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(name: str, value: float) -> str:
    if name in ("paused", "near"):
        return f"{value:.0%}".replace("%", " %")
    if name.startswith("speed"):
        return f"{value:.3f}"
    return f"{value:.2f}" if name in ("smoothness", "detour", "near_speed") else f"{value:.1f}"


def _is_brief(grips: Sequence[Segment], number: int, fps: float) -> bool:
    segment = grips[number]
    return bool(segment.label and 0 < number < len(grips) - 1 and segment.length < BRIEF_GRIP_S * fps)


def _norms(vectors: Vec) -> Vec:
    norms: Vec = np.linalg.norm(vectors, axis=1)
    return norms


def _median(values: Vec) -> float:
    return float(np.median(values)) if len(values) else float("nan")
