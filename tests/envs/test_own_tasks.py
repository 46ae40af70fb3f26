"""What does not fit together in a task of somebody's own is said in one sentence."""

from dataclasses import replace

import pytest

from lerobot_buds.core import ConfigError
from lerobot_buds.envs import TASKS, EnvSettings, RobosuiteEnv

PLAIN = TASKS["tool_use/cube_fetched"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"scene": "tool_uze"}, "Task tool_use/mine has a scene that is not there. Did you mean 'tool_use'?"),
        (
            {"goal": ("cube_in_pott",)},
            "needs the fact 'cube_in_pott', which its scene does not tell. Did you mean 'cube_in",
        ),
        ({"stages": ("open_drawer",)}, "needs the fact 'drawer_open', which its scene does not tell. Known: 'cube_fe"),
        ({"stages": ("cook",)}, "STAGE_FACTS does not say what stage 'cook' of tool_use/mine aims at."),
    ],
    ids=["scene", "goal", "fact of a stage", "stage"],
)
def test_it_is_refused_with_what_is_known(wrong, said, monkeypatch):
    monkeypatch.setitem(TASKS, "tool_use/mine", replace(PLAIN, name="tool_use/mine", **wrong))
    with pytest.raises(ConfigError) as error:
        RobosuiteEnv(EnvSettings("tool_use/mine", draws=False)).reset(seed=0)
    assert said in str(error.value)


def test_a_scene_may_be_given_itself(monkeypatch):
    from lerobot_buds.envs.simulation.scenes import SCENES

    monkeypatch.setitem(TASKS, "tool_use/mine", replace(PLAIN, name="tool_use/mine", scene=SCENES["tool_use"]))
    positions = []
    for name in (PLAIN.name, "tool_use/mine"):
        env = RobosuiteEnv(EnvSettings(name, draws=False))
        env.reset(seed=3)
        positions.append(env.state.position("cube_main").tolist())
        env.close()
    assert positions[0] == positions[1]
