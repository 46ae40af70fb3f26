"""Which features are cameras, told by LeRobot's feature type and never by name, and at what size frames are used."""

from collections.abc import Mapping
from typing import Any

from lerobot_buds.core import DatasetError

Features = Mapping[str, Mapping[str, Any]]
"""The features of ``meta/info.json`` by name."""

RGB = 3


def image_features(features: Features) -> list[str]:
    """Lists all image and video features in the order of their names, whatever their channels."""
    return sorted(name for name, feature in features.items() if feature["dtype"] in ("video", "image"))


def rgb_cameras(features: Features) -> list[str]:
    """Lists the cameras of three colour channels in the order of their names; depth maps are none."""
    return [name for name in image_features(features) if is_rgb(features[name])]


def is_rgb(feature: Mapping[str, Any]) -> bool:
    """Tells whether a feature holds RGB images."""
    return feature["dtype"] in ("video", "image") and _layout(feature)[0] == RGB and not is_depth(feature)


def is_depth(feature: Mapping[str, Any]) -> bool:
    """Tells whether LeRobot marked an image feature as a depth map, in either of its two spellings."""
    marks = {**(feature.get("video_info") or {}), **(feature.get("info") or {})}
    return bool(marks.get("is_depth_map") or marks.get("video.is_depth_map"))


def chosen_cameras(features: Features, wanted: list[str] | None, setting: str) -> list[str]:
    """Settles which cameras are used: those that are wanted, or all; never a depth map among colours in silence.

    Args:
        features: The dataset's features.
        wanted: Names of cameras; all image features where None.
        setting: The setting that names cameras, for the message.

    Raises:
        DatasetError: All are wanted, and some hold no RGB images; the message names them and what to set.
    """
    if wanted is not None:
        return list(wanted)
    others = [name for name in image_features(features) if not is_rgb(features[name])]
    if others:
        usable = rgb_cameras(features)
        shown = [f"{n!r} (shape {tuple(features[n]['shape'])}, names {features[n].get('names')})" for n in others]
        raise DatasetError(
            f"{', '.join(shown)}: depth, grey or other images that are no RGB images cannot be used beside colours. "
            f"Name the cameras to use, {setting}='[{', '.join(usable)}]', or correct meta/info.json."
        )
    return rgb_cameras(features)


def frame_size(feature: Mapping[str, Any], camera: str) -> tuple[int, int]:
    """Reads height and width (pixels) from an image feature, whichever place its channels have.

    Args:
        feature: Feature record of ``meta/info.json``.
        camera: Its name, for the message.

    Raises:
        DatasetError: The feature holds no RGB images.
    """
    if is_rgb(feature):
        _, height, width = _layout(feature)
        return height, width
    kind = "a depth map" if is_depth(feature) else f"of type {feature['dtype']}"
    raise DatasetError(
        f"{camera!r} is {kind}, of shape {tuple(feature['shape'])} and names {feature.get('names') or []}: no RGB "
        "camera. Leave it out of the cameras, or correct meta/info.json."
    )


def used_size(stored: tuple[int, int], side: int | None) -> tuple[int, int]:
    """Tells the size (pixels) at which frames are kept for networks that see squares of a side.

    Args:
        stored: Height and width of the stored frames.
        side: Side of the squares; None for frames as they are stored.

    Returns:
        ``(side, side)``; the stored size where that is smaller already, for nothing is enlarged.
    """
    return stored if side is None or min(stored) < side else (side, side)


def _layout(feature: Mapping[str, Any]) -> tuple[int, int, int]:
    """Reads channels, height and width; 0 for what has no such shape."""
    shape, names = tuple(int(size) for size in feature["shape"]), feature.get("names") or []
    if len(shape) != 3:
        return 0, 0, 0
    if len(names) == 3 and str(names[0]).startswith("channel"):
        return shape[0], shape[1], shape[2]
    return shape[2], shape[0], shape[1]
