"""Brings files to the Hugging Face Hub and from there: known names only, and one sentence for what goes wrong."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

import httpx
from huggingface_hub import CommitOperationAdd, HfApi, RepoUrl, snapshot_download
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


def upload(
    files: Mapping[str, Path],
    repo_id: str,
    message: str,
    *,
    private: bool | None = None,
    branch: str | None = None,
    repo_type: Literal["model", "dataset"] = "model",
) -> str:
    """Puts files into a repository, which is created where it is missing, in one commit.

    What has arrived by then stays there, so that after an interruption the same call sends what is missing.

    Args:
        files: Path in the repository -> the file; no other is sent.
        repo_id: For example ``"me/representation"``.
        message: Message of the commit.
        private: Whether a new repository is private; None for the account's own default.
        branch: Where to put them, created where missing; the main branch where None.
        repo_type: What the repository holds.

    Returns:
        Address of the repository.

    Raises:
        CheckpointError: The repository may not be written, or cannot be reached.
    """
    api = HfApi()
    additions = [CommitOperationAdd(name, path) for name, path in files.items()]

    def send() -> str:
        repo = _repository(repo_id, repo_type, private, branch)
        api.create_commit(repo.repo_id, additions, commit_message=message, revision=branch, repo_type=repo_type)
        return str(repo)

    with _in_one_sentence(repo_id, branch, sending=True):
        return _patiently(send)


def upload_dataset(
    root: Path, repo_id: str, private: bool | None = None, branch: str | None = None, **card: Any
) -> str:
    """Puts a LeRobotDataset into a repository by LeRobot's own call, with the tag that LeRobot looks for.

    What has arrived by then stays there, so that after an interruption the same call sends what is missing. A branch
    gets no tag: it is asked for by its name.

    Args:
        root: Its folder.
        repo_id: For example ``"me/serve_skills"``.
        private: Whether a new repository is private; None for the account's own default.
        branch: Where to put it, created where missing; the main branch where None.
        **card: What LeRobot's card is to say.

    Returns:
        Address of the repository.

    Raises:
        DatasetError: The repository may not be written, or cannot be reached.
    """
    from lerobot.datasets import LeRobotDataset

    # LeRobot lets a branch begin at the dataset's revision, by default a tag that a new repository does not have.
    dataset = LeRobotDataset(repo_id, root=root, revision="main")

    def send() -> str:
        repo = _repository(repo_id, "dataset", private, None)
        dataset.push_to_hub(branch=branch, private=private, tag_version=branch is None, **card)
        return str(repo)

    with _in_one_sentence(repo_id, branch, DatasetError, sending=True):
        return _patiently(send)


def _repository(repo_id: str, repo_type: str, private: bool | None, branch: str | None) -> RepoUrl:
    repo: RepoUrl = HfApi().create_repo(repo_id, repo_type=repo_type, private=private, exist_ok=True)
    if branch is not None:
        HfApi().create_branch(repo.repo_id, branch=branch, repo_type=repo_type, exist_ok=True)
    return repo


def _patiently[T](fetch: Callable[[], T]) -> T:
    """Fetches again, a few times, where the Hub fails by its own fault."""
    for pause in PAUSES_S:
        try:
            return fetch()
        except (HfHubHTTPError, LocalEntryNotFoundError, RuntimeError) as error:
            if (_status(error) or 0) < 500:
                raise
            time.sleep(pause)
    return fetch()


@contextmanager
def _in_one_sentence(
    repo_id: str, revision: str | None = None, refusal: type[BudsError] = CheckpointError, sending: bool = False
) -> Iterator[None]:
    try:
        yield
    except HFValidationError as error:
        place = "" if sending else "neither a folder on this machine nor "
        raise refusal(f"{repo_id!r} is {place or 'not '}the name of a repository, such as 'user/name'.") from error
    except ValueError as error:
        if "Invalid filename" not in str(error):
            raise
        raise refusal(f"{repo_id!r} was not fetched: it has a file whose name leads out of it ({error}).") from error
    except RevisionNotFoundError as error:
        raise refusal(f"{repo_id!r} has no revision {revision!r} on the Hub.") from error
    except (HfHubHTTPError, LocalEntryNotFoundError, OfflineModeIsEnabled, httpx.TransportError) as error:
        raise refusal(_sentence(repo_id, _status(error), sending)) from error
    except RuntimeError as error:
        # One of several uploads at once.
        if not isinstance(error.__cause__, HfHubHTTPError | httpx.TransportError):
            raise
        raise refusal(_sentence(repo_id, _status(error), sending)) from error


def _status(error: BaseException) -> int | None:
    """Reads what the Hub answered; None where it gave no answer."""
    # huggingface_hub looks into its cache when the Hub fails; if that fails too, the answer is the cause.
    answer = error if isinstance(error, HfHubHTTPError) else error.__cause__
    return answer.response.status_code if isinstance(answer, HfHubHTTPError) else None


def _sentence(repo_id: str, status: int | None, sending: bool) -> str:
    again = "; what has arrived is not sent twice" if sending else ""
    if status is None and sending:
        return (
            f"{repo_id!r} was not sent, as the Hub cannot be reached: connect, unset HF_HUB_OFFLINE, and run the same "
            f"again{again}."
        )
    if status is None:
        return f"{repo_id!r} is not on this machine and the Hub cannot be reached: connect, and unset HF_HUB_OFFLINE."
    if status in (401, 403, 404):
        place = "neither a folder on this machine nor a repository of the Hub that may be used from here"
        return (
            f"{repo_id!r} is {'no repository that may be written from here' if sending else place} (status {status}): "
            "check the name, or log in with 'hf auth login'."
        )
    return f"the Hub answered with status {status} when asked for {repo_id!r}: try again later{again}."
