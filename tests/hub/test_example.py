"""What examples/3_share.py pushes is found by its name, and pushed again it is the newer one that is found."""

import json
import shutil
from pathlib import Path

from lerobot_buds.segmentation import load_labels

SHARE = Path(__file__).parents[2] / "examples/3_share.py"
RUN = """
import json, runpy, sys
from pathlib import Path
from huggingface_hub import RepoCard
RepoCard.validate = lambda *_, **__: None  # asks huggingface.co, whatever HF_ENDPOINT says
root, script = map(Path, sys.argv[1:3])
main = runpy.run_path(str(script))["main"]
for words in ("first", "second"):
    (root / "NOTES.md").write_text(words)
    main([f"--root={root}", "--repo_id=me/skills", "--push"])
from lerobot_buds.data import download_dataset
from lerobot_buds.segmentation import load_labels
place = download_dataset("me/skills")
record, skill_id, _ = load_labels(place)
card = (place / "README.md").read_text()
assert "lerobot" in card.lower() and "lerobot-buds-segment" in card
print(json.dumps([str(place), record.n_skills, len(skill_id), (place / "NOTES.md").read_text()]))
"""


def test_a_shared_dataset_is_found_by_its_name(hub, segmented: Path, tmp_path: Path) -> None:
    shutil.copytree(segmented, tmp_path / "skills")
    done = hub.run(RUN, tmp_path / "skills", SHARE)
    assert done.returncode == 0, done.stderr[-3000:]
    place, n_skills, frames, notes = json.loads(done.stdout.splitlines()[-1])
    record, skill_id, _ = load_labels(segmented)
    assert not Path(place).is_relative_to(tmp_path)
    assert (n_skills, frames, notes) == (record.n_skills, len(skill_id), "second")
