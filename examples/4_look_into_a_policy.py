"""4. Look into a policy: which link is weak on recorded demonstrations, what it decides in the task, why it fails.

    python examples/4_look_into_a_policy.py --policy=outputs/serve_policy/checkpoints/last/pretrained_model --root=outputs/serve_skills --output_dir=outputs/look

How to read both tables: docs/diagnosis.md and docs/rollouts.md. The commands are `lerobot-buds-diagnose` and
`lerobot-buds-rollout`.
"""  # noqa: E501

import argparse
from pathlib import Path

from lerobot_buds.cli.diagnose import DiagnoseConfig, diagnose_policy, table
from lerobot_buds.cli.rollout import RolloutConfig, roll_out
from lerobot_buds.envs.configuration_robosuite import RobosuiteEnvConfig
from lerobot_buds.evaluation import RolloutRecord, summary_table


def main(arguments: list[str] | None = None) -> RolloutRecord:
    """Diagnoses a policy without a simulator, then runs it in the one it was made for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", required=True, help="folder or repository of the checkpoint")
    parser.add_argument("--root", type=Path, required=True, help="the segmented dataset that it was trained on")
    parser.add_argument("--output_dir", type=Path, required=True, help="for the record, the ribbons and the videos")
    parser.add_argument("--task", default="multitask_kitchen/task3_variant1")
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--episode_length", type=int, default=400, help="control steps at most")
    parser.add_argument("--image_size", type=int, default=128, help="as recorded (pixels)")
    parser.add_argument("--render_profile", default="fast", help="as recorded")
    chosen = parser.parse_args(arguments)

    print(table(diagnose_policy(DiagnoseConfig("local/dataset", chosen.root, policy_path=chosen.policy))))

    env = RobosuiteEnvConfig(
        task=chosen.task,
        episode_length=chosen.episode_length,
        image_size=chosen.image_size,
        render_profile=chosen.render_profile,
    )
    record = roll_out(
        RolloutConfig(chosen.policy, chosen.output_dir, env=env, dataset_root=chosen.root, episodes=chosen.episodes)
    )
    print(summary_table(record))
    for episode in record.episodes:
        skills = [decision.skill for decision in episode.decisions]
        print(f"seed {episode.seed}: {'success' if episode.success else 'no success'}, skills {skills}")
    print(f"ribbons and videos: {chosen.output_dir}")
    return record


if __name__ == "__main__":
    main()
