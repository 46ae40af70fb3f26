"""Render profiles by name: what is drawn, traded against speed on software OpenGL. Plain data.

Images of different profiles differ, so a profile is chosen once, recorded with the demonstrations and checked at
evaluation.
"""

from dataclasses import dataclass

from lerobot_buds.core import ConfigError, near_names


@dataclass(frozen=True)
class RenderProfile:
    """What the renderer draws.

    Attributes:
        collision_meshes: Draws the robot's collision meshes (15 k triangles) instead of its visual ones (168 k).
        multisampling: Samples per pixel; 0 for none.
        reflections: Draws the floor's faint mirror image, which costs a second pass over the scene.
    """

    collision_meshes: bool
    multisampling: int
    reflections: bool


PROFILES = {
    "fast": RenderProfile(collision_meshes=True, multisampling=4, reflections=False),
    "fastest": RenderProfile(collision_meshes=True, multisampling=0, reflections=False),
    "full": RenderProfile(collision_meshes=False, multisampling=4, reflections=True),
}


def profile_named(name: str) -> RenderProfile:
    """Looks up a profile.

    Raises:
        ConfigError: There is no profile of that name.
    """
    if name not in PROFILES:
        raise ConfigError(f"There is no render profile {name!r}. {near_names(name, PROFILES)}")
    return PROFILES[name]
