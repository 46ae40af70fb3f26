"""3. Share a segmented dataset: put it on the Hub, or its labels alone, for others to train with and to build on.

    python examples/3_share.py --root=outputs/serve_skills --repo_id=me/serve_skills                # says what it would send
    python examples/3_share.py --root=outputs/serve_skills --repo_id=me/serve_skills --push         # after: hf auth login
    python examples/3_share.py --root=outputs/serve_skills --repo_id=me/serve_labels --labels_only  # of anybody's dataset

`lerobot-buds-share` does the same. Record, names, representation and exemplars of the skills travel with a dataset, and a
card with its timeline. Its labels alone are a companion without recordings, which `lerobot-buds-join` joins with its
source. More: docs/sharing.md.
"""  # noqa: E501

import argparse
from pathlib import Path

from lerobot_buds.cli.share import ShareConfig, share
from lerobot_buds.segmentation import load_labels


def main(arguments: list[str] | None = None) -> list[str]:
    """Shares a dataset or its labels, or lists what would be sent."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, required=True, help="folder of a segmented dataset")
    parser.add_argument("--repo_id", required=True, help="its name on the Hub, such as me/serve_skills")
    parser.add_argument("--labels_only", action="store_true", help="a companion of labels, without recordings")
    parser.add_argument("--output_root", type=Path, help="folder to create for a companion")
    parser.add_argument("--private", action="store_true")
    parser.add_argument("--push", action="store_true", help="without it nothing is sent")
    chosen = parser.parse_args(arguments)

    record, _, _ = load_labels(chosen.root)  # what nobody could use is not shared
    config = ShareConfig(
        chosen.root.absolute(),
        chosen.repo_id,
        private=chosen.private or None,
        labels_only=chosen.labels_only,
        output_root=chosen.output_root and chosen.output_root.absolute(),
        push_to_hub=chosen.push,
    )
    if chosen.push:
        print(f"Shared: {share(config)}")
        others = "lerobot-buds-join" if chosen.labels_only else "lerobot-train --policy.type=buds"
        print(f"For others: {others} --{'' if chosen.labels_only else 'dataset.'}repo_id={chosen.repo_id}")
        return []

    folder = Path(share(config)) if chosen.labels_only else chosen.root  # a companion is written, and not sent
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    names = [str(path.relative_to(folder)) for path in files]
    size = sum(path.stat().st_size for path in files)
    print(f"{chosen.repo_id}: {record.n_skills} skills, {len(files)} files, {size / 2**20:.1f} MiB in {folder}")
    print(*names, sep="\n")
    print("Nothing was sent; --push does.")
    return names


if __name__ == "__main__":
    main()
