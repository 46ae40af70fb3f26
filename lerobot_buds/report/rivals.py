"""What ``lerobot-buds-compare`` found of other methods on the same demonstrations, as plain data for the page."""

from pathlib import Path
from typing import Any

import numpy as np

from lerobot_buds.core import DatasetError, read_json
from lerobot_buds.data import Origin

COLUMNS = {
    "boundary F1": 2,
    "segment F1": 2,
    "NMI": 2,
    "ARI": 2,
    "F1@50": 1,
    "Edit": 1,
    "MoF": 1,
    "mIoU": 1,
    "skills": 1,
}
"""Which of its columns are shown, with how many digits."""

ORACLE = "true stages"
"""The method that is told where stages change."""


def rivals(path: Path, origin: Origin) -> dict[str, Any]:
    """Reads a comparison.

    Args:
        path: The ``comparison.json`` of ``lerobot-buds-compare``.
        origin: The demonstrations beside whose scores its own will stand.

    Returns:
        ``columns`` (names), ``rows`` (method, and for every column its mean as text, its range as text, and whether it
        is the best of all methods but the oracle) and ``seeds``, their number.

    Raises:
        DatasetError: The file cannot be read, is none of that command, or is of other demonstrations; those of early
            versions do not tell.
    """
    try:
        found = read_json(path)
        rows = {str(row["method"]): [_figures(row[name]) for name in COLUMNS] for row in found}
        seeds = max(len(row["seeds"]) for row in found)
        compared = {**found[0].get("dataset", {})}
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{path} holds no comparison ({type(error).__name__}: {error}): lerobot-buds-compare writes one, as "
            "comparison.json in its work_dir."
        ) from error
    if origin.content is not None and compared.get("content", origin.content) != origin.content:
        raise DatasetError(
            f"{path} compares methods on other demonstrations, those of {compared.get('repo_id')!r}: name the file of "
            "these, or report on those that were compared, with --episodes where they were chosen."
        )
    means = np.array([[mean for mean, _, _ in figures] for method, figures in rows.items() if method != ORACLE])
    top = dict(zip(COLUMNS, means.max(axis=0).tolist() if len(means) else (), strict=False)) | {"skills": None}
    shown = [
        {
            "method": method,
            "cells": [
                {
                    "text": f"{mean:.{digits}f}",
                    "range": f"{low:.{digits}f} to {high:.{digits}f}",
                    "best": method != ORACLE and mean == top.get(name),
                }
                for (name, digits), (mean, low, high) in zip(COLUMNS.items(), figures, strict=True)
            ],
        }
        for method, figures in rows.items()
    ]
    return {"columns": list(COLUMNS), "rows": shown, "seeds": seeds}


def _figures(score: dict[str, float]) -> tuple[float, float, float]:
    return float(score["mean"]), float(score["low"]), float(score["high"])
