"""1. Segment your dataset: find the skills of its demonstrations and write them into a copy.

    lerobot-buds-collect --repo_id=me/serve --root=outputs/serve --episodes=8
    python examples/1_segment.py --repo_id=me/serve --root=outputs/serve --output_root=outputs/serve_skills

Any LeRobotDataset of format v3 will do; the first line only makes one. `lerobot-buds-segment` does the same.
"""

import argparse
from pathlib import Path

from lerobot_buds.cli.segment import SegmentConfig, segment
from lerobot_buds.representation import RepresentationConfig
from lerobot_buds.segmentation import SegmentationRecord


def main(arguments: list[str] | None = None) -> SegmentationRecord:
    """Segments a dataset and prints what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repo_id", required=True)
    parser.add_argument("--root", type=Path, help="its folder; without it, LeRobot's own place, or the Hub")
    parser.add_argument("--output_root", type=Path, required=True, help="folder of the labelled copy, not there yet")
    parser.add_argument("--image_size", type=int, default=64, help="side of the images that are looked at (pixels)")
    parser.add_argument("--steps", type=int, default=800, help="gradient steps of the representation")
    chosen = parser.parse_args(arguments)

    work_dir = chosen.output_root.with_name(f"{chosen.output_root.name}_work")
    small = RepresentationConfig(
        image_size=chosen.image_size, steps=chosen.steps, batch_size=32, learning_rate=2e-3, patience=0
    )  # for two CPU cores; RepresentationConfig() is the paper's size, for a GPU
    found = segment(
        SegmentConfig(
            chosen.repo_id, chosen.root, output_root=chosen.output_root, work_dir=work_dir, representation=small
        )
    )
    assert found is not None

    stability = "unknown" if found.stability is None else f"{found.stability:.2f}"
    print(f"{found.n_skills} skills in {len(found.episodes)} demonstrations; stability {stability}")
    for number, skill in enumerate(found.skills):
        print(f"  skill {number}: {skill['segments']} segments of {skill['mean_seconds']:.1f} s")
    for segment_ in found.episodes[0].segments:
        start, end = segment_.start / found.source.fps, segment_.end / found.source.fps
        print(f"  demonstration 0, {start:5.1f} to {end:5.1f} s: skill {segment_.label}")
    print(f"timelines: {work_dir / 'timeline.png'}; labels: the columns skill_id and subgoal_index")
    return found


if __name__ == "__main__":
    main()
