"""The record of a collection: absent, older, newer, damaged."""

from pathlib import Path

import pytest

from lerobot_buds.core import COLLECTION_FILE, DatasetError, write_json
from lerobot_buds.data import read_collection


def test_a_dataset_without_a_record_has_an_empty_one(tmp_path: Path) -> None:
    assert read_collection(tmp_path) == {}


@pytest.mark.parametrize("record", [{"render_profile": "fast"}, {"version": 1, "demonstrator": "scripted"}])
def test_older_records_are_read(tmp_path: Path, record: dict[str, object]) -> None:
    write_json(tmp_path / COLLECTION_FILE, record)
    assert read_collection(tmp_path) == record


def test_a_newer_record_is_refused_with_the_version_to_install(tmp_path: Path) -> None:
    write_json(tmp_path / COLLECTION_FILE, {"version": 3, "versions": {"lerobot_policy_buds": "0.9.1"}})
    with pytest.raises(DatasetError, match=r"collection\.json has format 3.*Install lerobot_policy_buds>=0\.9\.1"):
        read_collection(tmp_path)


@pytest.mark.parametrize("content", ["{", "[1]", "null"])
def test_a_damaged_record_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / COLLECTION_FILE
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with pytest.raises(DatasetError, match=r"collection\.json is damaged.*fetch the dataset again"):
        read_collection(tmp_path)
