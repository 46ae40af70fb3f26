"""Measures what default discovery finds in clean demonstrations of any length: 3 to 6 stages in 6 to 120 seconds.

Latents rest at a place, move to the next with minimum jerk, and carry a little noise; the stages are the movements.
Beside it stands the partition of the true stages, which no cut can be expected to exceed.

    python scripts/benchmark_durations.py --output=outputs/durations
"""

import argparse
import json
from pathlib import Path
from statistics import mean

import numpy as np

from lerobot_buds.evaluation import agreement
from lerobot_buds.segmentation import DiscoveryConfig
from lerobot_buds.segmentation.baselines import stage_segments

SECONDS, STAGES, SEEDS = (6, 8, 12, 20, 30, 120), (3, 4, 5, 6), 3
OTHERS = (
    {"fps": 10},
    {"fps": 20},
    {"noise": 0.005},
    {"noise": 0.1},
    {"noise": 0.3},
    {"dims": 3},
    {"dims": 32},
    {"count": 10},
)
"""What else is tried, each with 4 stages in 8 s and 5 in 20 s."""


def demonstrations(
    seconds: float, stages: int, seed: int, *, count: int = 50, fps: int = 30, dims: int = 6, noise: float = 0.02
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Makes demonstrations: stages of equal lengths, jittered by up to 0.2 s, each a movement between two places.

    Returns:
        ``(T, dims)`` latents and ``(T,)`` true stages of every demonstration.
    """
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(stages + 1, dims))
    latents, truth = [], []
    for _ in range(count):
        total = int(seconds * fps)
        cuts = np.arange(1, stages) * total / stages + rng.uniform(-0.2, 0.2, stages - 1) * fps
        edges = [0, *cuts.astype(int).tolist(), total]
        stage = np.repeat(np.arange(stages), np.diff(edges))
        along = np.concatenate([np.linspace(0, 1, length) for length in np.diff(edges)])[:, None]
        along = 10 * along**3 - 15 * along**4 + 6 * along**5
        path = places[stage] + along * (places[stage + 1] - places[stage])
        latents.append(path + noise * rng.normal(size=path.shape))
        truth.append(stage)
    return latents, truth


def scores(seconds: float, stages: int, seeds: int = SEEDS, **generator: float) -> list[dict[str, float]]:
    """Scores the defaults and the partition of the true stages, one mapping a seed."""
    rows = []
    for seed in range(seeds):
        latents, truth = demonstrations(seconds, stages, seed, **generator)  # type: ignore[arg-type]
        fps = generator.get("fps", 30)
        found = DiscoveryConfig().build(fps).fit(latents)
        oracle = DiscoveryConfig().build(fps).fit(latents, segments=[stage_segments(t) for t in truth])
        of_found, of_oracle = (agreement(result.labels_, truth, fps) for result in (found, oracle))
        rows.append(
            {
                "nmi": of_found.nmi,
                "oracle": of_oracle.nmi,
                "boundary_f1": of_found.boundary_f1,
                "skills": found.n_skills_,
                "window": found.durations_.window,
                "segments": found.durations_.segments_per_episode,
            }
        )
    return rows


def table(results: dict[str, list[dict[str, float]]]) -> str:
    """Formats the results in Markdown: mean and least NMI, the oracle's mean, boundary F1 and numbers of skills."""
    lines = ["| demonstrations | NMI (least) | true stages | boundary F1 | skills |", "|---" * 5 + "|"]
    for name, rows in results.items():
        nmi, oracle, f1 = ([row[key] for row in rows] for key in ("nmi", "oracle", "boundary_f1"))
        skills = ", ".join(str(int(row["skills"])) for row in rows)
        lines.append(f"| {name} | {mean(nmi):.2f} ({min(nmi):.2f}) | {mean(oracle):.2f} | {mean(f1):.2f} | {skills} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measures all of it, prints the table and writes it, with every figure as JSON beside it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("outputs/durations"), help="folder of the results")
    parser.add_argument("--others", action="store_true", help="other noise, sizes and frame rates, instead of lengths")
    options = parser.parse_args()
    results: dict[str, list[dict[str, float]]] = {}
    if options.others:
        for change in OTHERS:
            for seconds, stages in ((8, 4), (20, 5)):
                what = ", ".join(f"{key} {value}" for key, value in change.items())
                results[f"{stages} stages in {seconds} s, {what}"] = scores(seconds, stages, **change)
    else:
        for seconds in SECONDS:
            for stages in STAGES:
                results[f"{stages} stages in {seconds} s"] = scores(seconds, stages)
                print(table(dict([list(results.items())[-1]])).splitlines()[-1], flush=True)
    options.output.mkdir(parents=True, exist_ok=True)
    name = "others" if options.others else "durations"
    (options.output / f"{name}.json").write_text(json.dumps(results, indent=1))
    (options.output / f"{name}.md").write_text(table(results))
    print(table(results), end="")


if __name__ == "__main__":
    main()
