"""Brings files to the Hugging Face Hub and from there: known names only, and one sentence for what goes wrong."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Literal

import httpx
from huggingface_hub import HfApi, snapshot_download
from huggingface_hub.errors import (
    HfHubHTTPError,
    HFValidationError,
    LocalEntryNotFoundError,
    OfflineModeIsEnabled,
    RevisionNotFoundError,
)

from lerobot_buds.core import BudsError, CheckpointError, DatasetError

PAUSES_S = (1.0, 2.0, 4.0)  # before a download is asked for again; huggingface_hub repeats uploads only


def download(
    repo_id: str, names: Sequence[str], revision: str | None = None, repo_type: Literal["model", "dataset"] = "model"
) -> Path:
    """Fetches files of a repository into the Hub's cache; without a connection, looks there alone.

    A Hub that answers with a status of 500 or more is asked a few times again.

    Args:
        repo_id: For example ``"me/representation"``.
        names: The files; no other file of the repository is fetched.
        revision: Branch, tag or commit; the main branch where None.
        repo_type: What the repository holds.

    Returns:
        Folder that holds the files, as far as the repository has them.

    Raises:
        CheckpointError: The repository or the revision does not exist, may not be read, or cannot be reached.
    """
    with _in_one_sentence(repo_id, revision):
        fetch = partial(snapshot_download, repo_id, revision=revision, repo_type=repo_type, allow_patterns=list(names))
        return Path(_patiently(fetch))


def download_dataset(repo_id: str, revision: str | None = None, episodes: Sequence[int] | None = None) -> Path:
    """Fetches a LeRobotDataset in the way of LeRobot, into its place; without a connection, looks there alone.

    Args:
        repo_id: For example ``"me/so101"``.
        revision: Branch, tag or commit; LeRobot's own version tag where None.
        episodes: The episodes that are needed; all where None.

    Returns:
        Its folder.

    Raises:
        DatasetError: The repository or the revision does not exist, may not be read, cannot be reached, or holds a
            dataset of another format.
    """
    from lerobot.datasets import CODEBASE_VERSION, LeRobotDataset
    from lerobot.datasets.utils import CompatibilityError
    from lerobot.utils.constants import HF_LEROBOT_HUB_CACHE

    chosen = None if episodes is None else list(episodes)
    with _in_one_sentence(repo_id, revision, DatasetError):
        try:
            return Path(_patiently(lambda: LeRobotDataset(repo_id, episodes=chosen, revision=revision)).root)
        except (OfflineModeIsEnabled, httpx.TransportError):
            # LeRobot asks the Hub for versions before it looks at what it has fetched earlier.
            tag = revision or CODEBASE_VERSION
            cached = partial(snapshot_download, cache_dir=HF_LEROBOT_HUB_CACHE, local_files_only=True)
            return Path(cached(repo_id, repo_type="dataset", revision=tag))
        except (CompatibilityError, NotImplementedError) as error:
            raise DatasetError(
                f"{repo_id!r} has no revision of format {revision or CODEBASE_VERSION} on the Hub: convert it with "
                "LeRobot's own tools first, or ask for another revision."
            ) from error
        except RuntimeError as error:
            if "codebase version" not in str(error):
                raise
            raise DatasetError(
                f"{repo_id!r} on the Hub has no tag of a version, by which LeRobot chooses: name a revision, such "
                "as --revision=main."
            ) from error


def upload(folder: Path, names: Sequence[str], repo_id: str, private: bool | None, message: str) -> str:
    """Puts files into a model repository, which is created where it is missing, in one commit.

    Args:
        folder: Holds the files.
        names: The files; no other file of the folder is sent.
        repo_id: For example ``"me/representation"``.
        private: Whether a new repository is private; None for the account's own default.
        message: Message of the commit.

    Returns:
        Address of the repository.

    Raises:
        CheckpointError: The repository may not be written, or cannot be reached.
    """
    api = HfApi()
    with _in_one_sentence(repo_id):
        repo = api.create_repo(repo_id, private=private, exist_ok=True)
        api.upload_folder(repo_id=repo.repo_id, folder_path=folder, allow_patterns=list(names), commit_message=message)
    return str(repo)


def _patiently[T](fetch: Callable[[], T]) -> T:
    """Fetches again, a few times, where the Hub fails by its own fault."""
    for pause in PAUSES_S:
        try:
            return fetch()
        except (HfHubHTTPError, LocalEntryNotFoundError) as error:
            if (_status(error) or 0) < 500:
                raise
            time.sleep(pause)
    return fetch()


@contextmanager
def _in_one_sentence(
    repo_id: str, revision: str | None = None, refusal: type[BudsError] = CheckpointError
) -> Iterator[None]:
    try:
        yield
    except HFValidationError as error:
        raise refusal(
            f"{repo_id!r} is neither a folder on this machine nor the name of a repository, such as 'user/name'."
        ) from error
    except RevisionNotFoundError as error:
        raise refusal(f"{repo_id!r} has no revision {revision!r} on the Hub.") from error
    except (HfHubHTTPError, LocalEntryNotFoundError, OfflineModeIsEnabled, httpx.TransportError) as error:
        raise refusal(_sentence(repo_id, _status(error))) from error


def _status(error: BaseException) -> int | None:
    """Reads what the Hub answered; None where it gave no answer."""
    # huggingface_hub looks into its cache when the Hub fails; if that fails too, the answer is the cause.
    answer = error if isinstance(error, HfHubHTTPError) else error.__cause__
    return answer.response.status_code if isinstance(answer, HfHubHTTPError) else None


def _sentence(repo_id: str, status: int | None) -> str:
    if status is None:
        return f"{repo_id!r} is not on this machine and the Hub cannot be reached: connect, and unset HF_HUB_OFFLINE."
    if status in (401, 403, 404):
        return (
            f"{repo_id!r} is neither a folder on this machine nor a repository of the Hub that may be used from here "
            f"(status {status}): check the name, or log in with 'hf auth login'."
        )
    return f"the Hub answered with status {status} when asked for {repo_id!r}: try again later."
