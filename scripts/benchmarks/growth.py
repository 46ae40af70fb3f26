"""How an update and a step of acting grow with the number of skills: one trunk for all, or a network each."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from .acting import acts, frames_of, percentiles
from .figures import Figure, Setting, median_seconds
from .synthetic import make_skills
from .training import LOOP, Data, plain_loop, updates


def measure(setting: Setting) -> Iterator[Figure]:
    """Times the same frames cut into more and more skills."""
    for skills in setting.size.skills:
        root = make_skills(setting.place / f"of_{skills}", setting.size.pixels, setting.size.frames, skills)
        data = Data.of(setting, root)
        builders = {LOOP: partial(plain_loop, data), "buds.yaml": partial(updates, data, "buds")}
        builders["buds_improved.yaml"] = partial(updates, data, "buds_improved")
        for name, build in builders.items():
            yield Figure(f"update, {name}", median_seconds(build(), setting.size.repeats), "s", at=skills)
        for name in ("buds", "buds_improved"):
            for figure in percentiles(f"acting, {name}.yaml", acts(data, name, frames_of(data), 1), setting):
                yield replace(figure, against="", at=skills)
