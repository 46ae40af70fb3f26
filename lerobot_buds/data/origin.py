"""Where a dataset comes from: its repository and commit, and a hash of every episode that its copies share."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lerobot_buds.core import ACTION, sha256_of_json

from .dataset import AnyDataset, LocalDataset

_TIMES = ("frame_index", "timestamp")
_OBSERVATION = "observation."


@dataclass(frozen=True)
class Origin:
    """Names a dataset, so that it can be found again and told from others.

    Attributes:
        repo_id: Its repository on the Hub, or its local name.
        commit: The commit that was fetched from the Hub; None where it was not.
        content: Hash of `content_hashes`; None where not all of its chosen episodes are on this machine.
    """

    repo_id: str | None
    commit: str | None
    content: str | None

    @classmethod
    def of(cls, dataset: AnyDataset) -> "Origin":
        """Finds out about a dataset.

        Raises:
            DatasetError: It is damaged.
        """
        local = LocalDataset.of(dataset)
        hashes = content_hashes(local)
        content = None if None in hashes else sha256_of_json(hashes)
        return cls(local.repo_id or _repository_of(local.root), commit_of(local.root), content)

    @property
    def known(self) -> dict[str, str]:
        """What is known of it, by name."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def content_hashes(dataset: AnyDataset) -> tuple[str | None, ...]:
    """Hashes what the robot felt and did in every chosen episode, and when.

    Frames may be renumbered, columns of other kinds added and tasks renamed without a change: labels are right all the
    same. Pictures are not read, which would take as long as decoding them; the commit says which they are.

    Args:
        dataset: What stands for the dataset.

    Returns:
        One hexadecimal string an episode, None for one that is not on this machine as a whole.

    Raises:
        DatasetError: The dataset is damaged.
    """
    given = LocalDataset.of(dataset)
    local = LocalDataset(given.root, given.chosen)  # under the names of the files
    kinds = {name: np.dtype(f["dtype"]) for name, f in local.features.items() if _is_hashed(name, f["dtype"])}
    found = {}
    for table in local.shards(list(kinds)):
        index = table["index"].to_numpy()
        if (np.diff(index) < 0).any():
            order = np.argsort(index, kind="stable")
            table, index = table.take(order), index[order]
        for record in local.episodes:
            start, end = int(record["dataset_from_index"]), int(record["dataset_to_index"])
            first, last = np.searchsorted(index, [start, end]).tolist()
            if last - first == end - start:
                found[int(record["episode_index"])] = _hash(table.slice(first, last - first), kinds)
    return tuple(found.get(int(record["episode_index"])) for record in local.episodes)


def commit_of(folder: Path) -> str | None:
    """Tells which commit a folder was fetched from, by what huggingface_hub leaves there; None where it was not.

    Args:
        folder: A snapshot in the Hub's cache, or a folder that files were fetched into.
    """
    if _repository_of(folder) is not None:
        return folder.name
    for note in sorted((folder / ".cache/huggingface/download").rglob("*.metadata")):
        lines = note.read_text(encoding="utf-8").splitlines()
        return lines[0] if lines else None
    return None


def shown_name(name: str) -> str:
    """Takes the folders off a path: where things lie is nobody's business on the Hub; names of repositories stay."""
    path = Path(name)
    return path.name if path.is_absolute() or len(path.parts) > 2 else name


def _repository_of(folder: Path) -> str | None:
    kind, *name = folder.parent.parent.name.split("--")
    return "/".join(name) if folder.parent.name == "snapshots" and kind in ("datasets", "models") else None


def _is_hashed(name: str, dtype: str) -> bool:
    is_told = name in (ACTION, *_TIMES) or name.startswith(_OBSERVATION)
    return is_told and dtype not in ("video", "image", "string")


def _hash(rows: pa.Table, kinds: dict[str, "np.dtype[Any]"]) -> str:
    digest = sha256()
    for name in sorted(kinds):
        digest.update(name.encode())
        for part in _flat(rows[name].chunks):
            values = part.to_numpy(zero_copy_only=False).astype(kinds[name].newbyteorder("<"), copy=False)
            digest.update(values.tobytes())
    return digest.hexdigest()


def _flat(parts: Sequence[pa.Array]) -> Iterator[pa.Array]:
    for part in parts:
        values = part
        while pa.types.is_nested(values.type) or isinstance(values, pa.ExtensionArray):
            values = values.storage if isinstance(values, pa.ExtensionArray) else values.flatten()
        yield values
