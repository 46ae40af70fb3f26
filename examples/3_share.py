"""3. Share a segmented dataset: put it on the Hub, where lerobot-train finds it by its name.

    python examples/3_share.py --root=outputs/serve_skills --repo_id=me/serve_skills           # says what it would send
    python examples/3_share.py --root=outputs/serve_skills --repo_id=me/serve_skills --push    # after: hf auth login

Record, representation and exemplars of the skills lie in the dataset's folder and travel with it. Others can train on
it, label demonstrations of their own with its skills (`lerobot-buds-segment --library=me/serve_skills`), or build it
again. A trained policy is pushed by `lerobot-train --policy.push_to_hub=true --policy.repo_id=me/serve_policy`.
"""

import argparse
from pathlib import Path

from lerobot.datasets import LeRobotDataset

from lerobot_buds.segmentation import load_labels


def main(arguments: list[str] | None = None) -> list[str]:
    """Uploads a dataset, or says what would be uploaded."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, required=True, help="folder of a segmented dataset")
    parser.add_argument("--repo_id", required=True, help="its name on the Hub, such as me/serve_skills")
    parser.add_argument("--license", help="under which you give it away, such as apache-2.0")
    parser.add_argument("--private", action="store_true")
    parser.add_argument("--push", action="store_true", help="without it nothing is sent")
    chosen = parser.parse_args(arguments)

    record, _, _ = load_labels(chosen.root)  # what nobody could use is not shared
    files = sorted(path for path in chosen.root.rglob("*") if path.is_file())
    names = [str(path.relative_to(chosen.root)) for path in files]
    size = sum(path.stat().st_size for path in files)
    print(f"{chosen.repo_id}: {record.n_skills} skills, {len(files)} files, {size / 2**20:.1f} MiB")
    if not chosen.push:
        print(*names, sep="\n")
        print("Nothing was sent; --push does.")
        return names

    # LeRobot's own way: it also writes a card, and the tag of the format's version, which it looks for when it loads.
    dataset = LeRobotDataset(chosen.repo_id, root=chosen.root)
    dataset.push_to_hub(license=chosen.license, private=chosen.private or None)
    print(f"lerobot-train --policy.type=buds --dataset.repo_id={chosen.repo_id}")
    return names


if __name__ == "__main__":
    main()
