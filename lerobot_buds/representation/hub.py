"""Brings files to the Hugging Face Hub and from there: known names only, and one sentence for what goes wrong."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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

from lerobot_buds.core import CheckpointError


def download(
    repo_id: str, names: Sequence[str], revision: str | None = None, repo_type: Literal["model", "dataset"] = "model"
) -> Path:
    """Fetches files of a repository into the Hub's cache; without a connection, looks there alone.

    What huggingface_hub repeats by itself, it repeats, with growing pauses.

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
        return Path(snapshot_download(repo_id, revision=revision, repo_type=repo_type, allow_patterns=list(names)))


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


@contextmanager
def _in_one_sentence(repo_id: str, revision: str | None = None) -> Iterator[None]:
    try:
        yield
    except HFValidationError as error:
        raise CheckpointError(
            f"{repo_id!r} is neither a folder on this machine nor the name of a repository, such as 'user/name'."
        ) from error
    except RevisionNotFoundError as error:
        raise CheckpointError(f"{repo_id!r} on the Hub has no revision {revision!r}.") from error
    except HfHubHTTPError as error:
        status = error.response.status_code
        if status in (401, 403, 404):
            raise CheckpointError(
                f"{repo_id!r} is neither a folder on this machine nor a repository of the Hub that may be used here "
                f"(status {status}); check the name, or log in with 'hf auth login'."
            ) from error
        raise CheckpointError(f"the Hub answered {status} to a request about {repo_id!r}; try again later.") from error
    except (LocalEntryNotFoundError, OfflineModeIsEnabled, httpx.TransportError) as error:
        raise CheckpointError(
            f"{repo_id!r} is not on this machine, and the Hub cannot be reached; connect once to fetch it (or unset "
            "HF_HUB_OFFLINE)."
        ) from error
