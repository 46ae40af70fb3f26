"""The environment that examples/envhub makes a repository of is found on the Hub by LeRobot, and evaluated on."""

import json
from pathlib import Path

EXAMPLE = Path(__file__).parents[2] / "examples/envhub"
CODE = """
import json, re, sys
from dataclasses import dataclass
from pathlib import Path

import lerobot_policy_buds
import torch
from huggingface_hub import HfApi
from lerobot.envs import EnvConfig, HubEnvConfig, close_envs, make_env, make_env_pre_post_processors
from lerobot.policies import make_pre_post_processors
from lerobot.scripts.lerobot_eval import eval_policy_all
from lerobot_buds.policy.modeling_buds import BudsPolicy

example, checkpoint = map(Path, sys.argv[1:])
HfApi().create_repo("me/tool-use")
HfApi().upload_folder(repo_id="me/tool-use", folder_path=example)
try:
    make_env("me/tool-use")
except RuntimeError as error:
    refusal = str(error)
names = {}
exec(re.search("```python\\n(.*?)```", (example / "README.md").read_text(), re.S)[1], names)


@EnvConfig.register_subclass("hub_task")
@dataclass
class HubTask(HubEnvConfig):
    hub_path: str = "me/tool-use"
    task: str = "multitask_kitchen/task3_variant1"
    episode_length: int = 3
    image_size: int = 32
    render_profile: str = "fastest"


config = HubTask()
envs = make_env(config, n_envs=2, trust_remote_code=True)
policy = BudsPolicy.from_pretrained(checkpoint).eval()
with torch.no_grad():
    info = eval_policy_all(
        envs,
        policy,
        *make_env_pre_post_processors(config, policy.config),
        *make_pre_post_processors(policy.config, checkpoint),
        n_episodes=2,
        start_seed=500_000,
    )
close_envs(envs)
shape = names["observation"]["pixels"]["agentview"].shape
print(json.dumps([refusal, names["env"].call("task"), shape, info["overall"]]))
"""


def test_it_is_made_and_evaluated_on_by_lerobots_own_code(hub, checkpoint: Path) -> None:
    done = hub.run(CODE, EXAMPLE, checkpoint)
    assert done.returncode == 0, done.stderr[-3000:]
    refusal, tasks, shape, overall = json.loads(done.stdout.splitlines()[-1])
    assert "trust_remote_code=True" in refusal
    assert (tasks, shape) == (["tool_use/cube_fetched"] * 2, [2, 128, 128, 3])
    assert overall["n_episodes"] == 2 and overall["pc_success"] == 0.0
