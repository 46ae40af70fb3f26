"""Writes a LeRobotDataset as people record them with an SO-101 arm, for tests and timings without a robot.

Two cameras of 640 x 480 as video, 30 Hz, six joint positions in degrees (the gripper in percent), actions that are the
leader arm's next positions. Every episode carries a cube onto a disc: reach, grasp, carry, release, which the column
``true_stage`` tells apart. Cube and disc lie elsewhere in every episode. The geometry and the drawing are ours.

    python scripts/make_so101.py --repo_id=me/so101 --root=outputs/so101
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from lerobot_buds.cli.running import dataset_root, parse, run
from lerobot_buds.core import ACTION, IMAGE_PREFIX, STATE, TRUE_STAGE, ConfigError
from lerobot_buds.data.writing import camera_feature, create_dataset, sort_stats, vector_feature

FPS = 30
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
TASK = "Put the red cube onto the green disc."
HOME_RADIUS, HOVER, HALF_CUBE, DISC = 0.14, 0.07, 0.0125, 0.03  # metres
SHOULDER, UPPER_ARM, FOREARM, HAND = 0.12, 0.116, 0.135, 0.12  # height, and lengths to the next joint (metres)
OPEN, CLOSED = 70.0, 25.0  # of the gripper (percent)
TABLE, WALL, LINES, RED, GREEN = (201, 182, 150), (228, 231, 235), (180, 160, 128), (200, 40, 40), (60, 160, 75)
ARM, FINGERS = ((70, 70, 76), (245, 200, 60), (235, 190, 50), (60, 60, 66)), (30, 30, 34)

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass
class So101Config:
    """What is written."""

    repo_id: str = "local/so101"
    """The dataset's name."""

    root: str | None = None
    """Its folder, which must not exist; None for LeRobot's own place for `repo_id`."""

    episodes: int = 50
    """Number of episodes."""

    seconds: float = 8.0
    """Length of each (seconds)."""

    height: int = 480
    """Height of both cameras (pixels)."""

    width: int = 640
    """Their width (pixels)."""

    seed: int = 0
    """Seed of where things lie and of how long motions take; an episode does not depend on how many there are."""


@dataclass(frozen=True)
class Episode:
    """One demonstration.

    Attributes:
        joints: ``(T, 6)`` degrees, the gripper in percent.
        stages: ``(T,)`` int64: 0 reach, 1 grasp, 2 carry, 3 release.
        cubes: ``(T, 4)``: the cube's x, y, z (m) and yaw (rad).
        disc: The disc's x and y (m).
    """

    joints: Floats
    stages: NDArray[np.int64]
    cubes: Floats
    disc: Floats


def pose(radius: float, pan: float, height: float, yaw: float, gripper: float) -> Floats:
    """Solves for the joints at which the fingertips point down at a place on a circle around the base.

    Args:
        radius: Distance from the base (m).
        pan: Direction from the base (rad).
        height: Above the table (m).
        yaw: Direction of the fingers, in the table's frame (rad).
        gripper: Percent open.

    Returns:
        ``(6,)`` joint positions (degrees, percent).
    """
    up = height + HAND - SHOULDER
    reach = np.hypot(radius, up)
    bend = np.arccos((UPPER_ARM**2 + FOREARM**2 - reach**2) / (2 * UPPER_ARM * FOREARM))
    lean = np.arctan2(radius, up) - np.arccos((UPPER_ARM**2 + reach**2 - FOREARM**2) / (2 * UPPER_ARM * reach))
    elbow = np.pi - bend
    angles = np.degrees([pan, lean, elbow - np.pi / 2, np.pi - lean - elbow, yaw - pan])
    return np.append(angles, gripper)


def chain(joints: Floats) -> tuple[Floats, Floats]:
    """Computes where the arm's joints are.

    Args:
        joints: ``(6,)`` degrees, percent.

    Returns:
        Base, shoulder, elbow, wrist and fingertips, ``(5, 3)`` (m), and the unit vector across the fingers, ``(3,)``.
    """
    pan, lift, elbow, flex, roll = np.radians(joints[:5])
    outward = np.array([np.cos(pan), np.sin(pan), 0.0])
    tilts = np.cumsum([lift, elbow + np.pi / 2, flex])  # from upright
    links = np.array([UPPER_ARM, FOREARM, HAND])[:, None] * (
        np.sin(tilts)[:, None] * outward + np.cos(tilts)[:, None] * np.array([0.0, 0.0, 1.0])
    )
    points = np.cumsum([np.zeros(3), [0.0, 0.0, SHOULDER], *links], axis=0)
    along = links[2] / HAND
    side = np.cross(np.array([0.0, 0.0, 1.0]), outward)
    return points, np.cos(roll) * side - np.sin(roll) * np.cross(along, side)


def demonstrate(rng: np.random.Generator, frames: int) -> Episode:
    """Moves along minimum-jerk paths between waypoints that depend on where cube and disc lie."""
    cube_at, cube_pan, cube_yaw = rng.uniform((0.15, -0.8, -0.5), (0.22, -0.15, 0.5))
    disc_at, disc_pan = rng.uniform((0.15, 0.15), (0.22, 0.8))
    cube, disc = (cube_at, cube_pan), (disc_at, disc_pan)
    plan = [  # stage, seconds where an episode has 8, waypoint
        (0, 1.4, pose(*cube, HOVER, cube_yaw, OPEN)),
        (0, 0.8, pose(*cube, HALF_CUBE, cube_yaw, OPEN)),
        (1, 0.9, pose(*cube, HALF_CUBE, cube_yaw, CLOSED)),
        (2, 0.7, pose(*cube, HOVER, cube_yaw, CLOSED)),
        (2, 1.4, pose(*disc, HOVER, 0.0, CLOSED)),
        (2, 0.7, pose(*disc, HALF_CUBE, 0.0, CLOSED)),
        (3, 0.7, pose(*disc, HALF_CUBE, 0.0, OPEN)),
        (3, 0.6, pose(*disc, HOVER, 0.0, OPEN)),
        (3, 0.8, pose(HOME_RADIUS, 0.0, HOVER, 0.0, CLOSED)),
    ]
    shares = np.array([seconds for _, seconds, _ in plan]) * rng.uniform(0.85, 1.15, len(plan))
    ends = np.round(np.cumsum(shares) / shares.sum() * frames).astype(int)
    before, paths, stages = pose(HOME_RADIUS, 0.0, HOVER, 0.0, CLOSED), [], []
    for (stage, _, after), count in zip(plan, np.diff(ends, prepend=0), strict=True):
        t = np.arange(1, count + 1)[:, None] / max(count, 1)
        paths.append(before + (after - before) * t**3 * (10 - 15 * t + 6 * t**2))
        stages += [stage] * count
        before = after
    joints, numbers = np.concatenate(paths), np.array(stages, np.int64)
    start = np.array([cube_at * np.cos(cube_pan), cube_at * np.sin(cube_pan), HALF_CUBE, cube_yaw])
    return Episode(
        joints, numbers, _cubes(joints, numbers, start), disc_at * np.array([np.cos(disc_pan), np.sin(disc_pan)])
    )


def _cubes(joints: Floats, stages: NDArray[np.int64], start: Floats) -> Floats:
    """Follows the cube: at its start, in the hand, and where it was put down."""
    cubes = np.tile(start, (len(joints), 1))
    for t, now in enumerate(joints):
        if stages[t] == 2:
            cubes[t] = [*chain(now)[0][-1], np.radians(now[0] + now[4])]
        elif stages[t] == 3 and t > 0:
            cubes[t] = cubes[t - 1]
    return cubes


class View:
    """A pinhole camera of a given pose, and the picture that is drawn through it.

    Args:
        image: ``(H, W, 3)`` uint8 RGB, drawn over.
        eye: Where the camera is (m).
        ahead: Where it looks at (m).
        up: Which way is up in the picture.
        zoom: Focal length, in heights of the picture.
    """

    def __init__(self, image: Image, eye: Floats, ahead: Floats, up: Floats, zoom: float) -> None:
        self.image = image
        forward = (ahead - eye) / np.linalg.norm(ahead - eye)
        right = np.cross(forward, up)
        right /= np.linalg.norm(right)
        self._eye, self._axes, self._zoom = eye, np.stack([right, np.cross(forward, right), forward]), zoom

    def pixels(self, points: Floats) -> NDArray[np.int32]:
        """Projects ``(N, 3)`` points (m) to ``(N, 2)`` pixels."""
        seen = (points - self._eye) @ self._axes.T
        height, width = self.image.shape[:2]
        middle = np.array([width, height]) / 2
        pixels = middle + seen[:, :2] / np.maximum(seen[:, 2:], 0.01) * self._zoom * height
        return np.asarray(np.round(pixels), np.int32)

    def fill(self, points: Floats, colour: tuple[int, int, int]) -> None:
        """Fills the convex hull of ``(N, 3)`` points (m)."""
        cv2.fillConvexPoly(self.image, cv2.convexHull(self.pixels(points)), colour, cv2.LINE_AA)

    def line(self, points: Floats, colour: tuple[int, int, int], thickness: float) -> None:
        """Draws a line through ``(N, 3)`` points (m), its thickness in hundredths of the picture's height."""
        size = max(1, round(thickness * self.image.shape[0] / 100))
        cv2.polylines(self.image, [self.pixels(points)], False, colour, size, cv2.LINE_AA)


def draw(episode: Episode, t: int, size: tuple[int, int]) -> dict[str, Image]:
    """Draws both cameras at one frame, ``(H, W, 3)`` uint8 RGB each.

    Args:
        episode: The demonstration.
        t: The frame's number.
        size: Height and width (pixels).
    """
    points, across = chain(episode.joints[t])
    wrist, tip = points[3], points[4]
    away = np.cross(tip - wrist, across) / HAND
    front = View(
        np.full((*size, 3), WALL, np.uint8), np.array([0.6, 0, 0.45]), np.array([0.1, 0, 0.05]), np.eye(3)[2], 1.9
    )
    hand = View(np.full((*size, 3), TABLE, np.uint8), wrist - 0.05 * away, tip, away, 0.6)
    front.fill(_square(0.45), TABLE)
    for view in (front, hand):
        for ends in _grid():
            view.line(ends, LINES, 0.3)
        view.fill(_disc(episode.disc), GREEN)
    for link in range(4):
        front.line(points[link : link + 2], ARM[link], 5.0)
    for view in (front, hand):
        view.fill(_cube(episode.cubes[t]), RED)
        for finger in (-1, 1):
            base = wrist + 0.5 * (tip - wrist)
            gap = finger * across * 0.05 * episode.joints[t, 5] / 100
            view.line(np.stack([base, base + 1.2 * gap, tip + gap]), FINGERS, 2.0)
    return {"front": front.image, "wrist": hand.image}


def _square(half: float) -> Floats:
    return np.array([[x, y, 0.0] for x in (-half, half) for y in (-half, half)])


def _grid() -> Iterator[Floats]:
    for at in np.linspace(-0.4, 0.4, 9):
        yield np.array([[at, -0.4, 0.0], [at, 0.4, 0.0]])
        yield np.array([[-0.4, at, 0.0], [0.4, at, 0.0]])


def _disc(middle: Floats) -> Floats:
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    return np.stack([middle[0] + DISC * np.cos(turn), middle[1] + DISC * np.sin(turn), np.zeros(24)], axis=1)


def _cube(place: Floats) -> Floats:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * HALF_CUBE
    cos, sin = np.cos(place[3]), np.sin(place[3])
    return np.asarray(place[:3] + corners @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]))


def make(config: So101Config) -> Path:
    """Writes the dataset.

    Returns:
        Its folder.

    Raises:
        ConfigError: There would be nothing in it.
    """
    frames = round(config.seconds * FPS)
    if min(config.episodes, config.height, config.width) < 1 or frames < 1:
        raise ConfigError("An episode needs a frame, a dataset an episode, and an image a pixel.")
    root = dataset_root(config.repo_id, config.root)
    names = [f"{joint}.pos" for joint in JOINTS]
    cameras = {
        IMAGE_PREFIX + name: camera_feature((config.height, config.width, 3), True) for name in ("front", "wrist")
    }
    stage = {"dtype": "int64", "shape": (1,), "names": None}
    features = {ACTION: vector_feature(names), STATE: vector_feature(names), **cameras, TRUE_STAGE: stage}
    dataset = create_dataset(config.repo_id, root, FPS, features, "so101_follower")
    for number in tqdm(range(config.episodes), desc="episodes", unit="episode", dynamic_ncols=True):
        episode = demonstrate(np.random.default_rng((config.seed, number)), frames)
        for t in range(frames):
            dataset.add_frame(_row(episode, t, (config.height, config.width)))
        dataset.save_episode()
    dataset.finalize()
    sort_stats(root)
    return root


def _row(episode: Episode, t: int, size: tuple[int, int]) -> dict[str, Any]:
    joints = episode.joints.astype(np.float32)
    images = {IMAGE_PREFIX + name: image for name, image in draw(episode, t, size).items()}
    leader = joints[min(t + 1, len(joints) - 1)]
    return {ACTION: leader, STATE: joints[t], TRUE_STAGE: episode.stages[t : t + 1], "task": TASK, **images}


def main() -> None:
    """Writes the dataset that the arguments describe."""
    config = parse(So101Config)
    print(run(lambda: make(config)))


if __name__ == "__main__":
    main()
