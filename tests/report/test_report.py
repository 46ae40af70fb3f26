"""What the page shows, by hand; that texts of a dataset stay texts; that the file is the same every time."""

import json
import re
import shutil
from base64 import b64decode
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from lerobot_buds.core import DatasetError, SegmentationError, write_json
from lerobot_buds.data import LocalDataset, Origin
from lerobot_buds.evaluation import Demonstrations, compare, comparison_rows
from lerobot_buds.report import Content, rivals, write_report
from lerobot_buds.report.cards import cards
from lerobot_buds.report.demonstrations import demonstrations
from lerobot_buds.report.pictures import BUDGET, BYTES, HEIGHT, Pictures, data_uri, middles
from lerobot_buds.report.rivals import COLUMNS
from lerobot_buds.report.scores import scores
from lerobot_buds.report.writing import render, skill_colors
from lerobot_buds.segmentation import REPRESENTATION_DIR, DiscoveryConfig

pytestmark = pytest.mark.slow

ANY = Origin(None, None, None)
HOSTILE = "</script><script>hacked = 1</script><img src=x onerror='hacked = 2'>&amp;"


def no_pictures(content):
    return Pictures(content.dataset, content.side, len(content.numbers))


def test_cards_by_hand(content):
    first, second, third = cards(content, no_pictures(content))
    assert [card["segments"] for card in (first, second, third)] == [3, 3, 1]
    assert first["share"] == 8 / 28
    assert (second["shortest"], second["median"], second["longest"], second["scale"]) == (0.2, 0.6, 0.8, 0.8)
    assert [example["seconds"] for example in second["examples"]] == [0.2, 0.6, 0.8]
    assert [(example["place"], example["start"]) for example in third["examples"]] == [(1, 2)]
    assert first["before"] == [{"skill": -1, "count": 3, "share": 1.0}]
    assert [(item["skill"], item["count"]) for item in first["after"]] == [(1, 2), (2, 1)]
    assert [(item["skill"], item["count"]) for item in second["after"]] == [(-1, 3)]
    assert first["tasks"] == [{"task": "make tea", "using": 1, "of": 1}, {"task": "tidy up", "using": 2, "of": 2}]
    assert third["tasks"] == [{"task": "tidy up", "using": 1, "of": 2}]
    assert first["bars"][6] == 1 and sum(bar > 0 for bar in first["bars"]) == 2  # 0.2 s twice, 0.4 s once, of 0.8 s


def test_a_skill_that_does_not_occur_has_an_empty_card(content):
    unused = replace(content, record=replace(content.record, n_skills=4))
    card = cards(unused, no_pictures(unused))[3]
    assert (card["segments"], card["examples"], card["tasks"], card["before"]) == (0, [], [], [])
    assert "Skill 3" in render(unused, "me/demo")
    named = replace(unused, names=("reach", "grasp", "<b>lift</b>", "rest"))
    assert "grasp</h3>" in render(named, "me/demo") and "&lt;b&gt;lift" in render(named, "me/demo")


def test_timelines_and_trees_by_hand(content):
    first, second, _ = demonstrations(content, no_pictures(content))
    assert first["skills"] == [[4, 0], [10, 1]] and first["stages"] == [[5, 0], [10, 1]]
    assert first["segments"] == [4, 10]
    leaves, inner = [[0, 4, -1, -1, 0], [4, 7, -1, -1, 1], [7, 10, -1, -1, 1]], [[4, 10, 1, 2, 1], [0, 10, 0, 3, -1]]
    assert first["nodes"] == leaves + inner
    assert second["nodes"] == [[0, 8, -1, -1, -1]]


def test_scores_are_those_of_the_shown_demonstrations(content):
    shown = scores(content)
    assert {name: value for name, value, _ in shown["matched_scores"]}["MoF"] == f"{100 * 23 / 28:.1f}"
    assert [[cell["matched"] for cell in row["cells"]] for row in shown["confusion"]] == [[1, 0], [0, 1], [0, 0]]
    assert [cell["share"] for cell in shown["confusion"][1]["cells"]] == [1 / 16, 15 / 16]
    assert scores(replace(content, stages=None)) is None


def test_other_methods_stand_beside_where_they_were_compared(content, tmp_path):
    rng = np.random.default_rng(0)
    latents = [rng.normal(size=(60, 3)) + 5 * (np.arange(60) >= 30)[:, None] for _ in range(3)]
    stages = [np.repeat([0, 1], 30)] * 3
    data = Demonstrations(latents, latents, stages, latents, [x[:, 0] for x in latents], 10.0)
    methods = ["default", "uniform", "prediction error", "true stages"]
    results = [r for seed in (0, 1) for r in compare(data, DiscoveryConfig(max_skills=2), seed, methods)]
    write_json(tmp_path / "comparison.json", comparison_rows(results))
    compared = rivals(tmp_path / "comparison.json", ANY)
    assert [row["method"] for row in compared["rows"]] == methods and compared["seeds"] == 2
    place = compared["columns"].index("boundary F1")
    default, uniform, _, oracle = (row["cells"][place] for row in compared["rows"])
    assert (default["text"], default["range"], default["best"]) == ("1.00", "1.00 to 1.00", True)
    assert not uniform["best"] and not oracle["best"] and oracle["text"] == "1.00"
    assert "Beside other methods" in (page := render(content, "me/demo", compared))
    assert "uniform</th>" in page and "Beside other methods" not in render(content, "me/demo")
    without_stages = render(replace(content, stages=None), "me/demo", compared)
    assert "uniform</th>" in without_stages and "NMI</th>" in without_stages


@pytest.mark.parametrize("text", ["", "{}", "[]", '[{"method": "default"}]', '{"seeds": 3}'])
def test_what_is_no_comparison_is_refused(tmp_path, text):
    path = tmp_path / "comparison.json"
    path.write_text(text)
    with pytest.raises(DatasetError, match=r"holds no comparison .*lerobot-buds-compare writes one"):
        rivals(path, ANY)
    with pytest.raises(DatasetError, match="FileNotFoundError"):
        rivals(tmp_path / "missing.json", ANY)


def test_a_comparison_of_other_demonstrations_is_refused(segmented, demonstrations, tmp_path):
    """They may be as many and as long; a segmented copy has those of its source."""
    path, source = tmp_path / "comparison.json", Origin.of(demonstrations)
    row = {"method": "uniform", "seeds": [0], **{name: {"mean": 0, "low": 0, "high": 0} for name in COLUMNS}}
    write_json(path, [row | {"dataset": source.known}])
    assert rivals(path, Origin.of(segmented))["rows"][0]["method"] == "uniform"
    part = Origin.of(LocalDataset(segmented, chosen=(0, 1)))
    with pytest.raises(DatasetError, match=r"on other demonstrations, those of .*with --episodes"):
        rivals(path, part)
    write_json(path, [row])  # of an early version
    assert rivals(path, part)["seeds"] == 1


def test_what_is_not_known_is_left_out(content):
    bare = replace(content, stages=None, structures=None, collection={}, tasks=[(), (), ()])
    page = render(bare, "me/demo")
    assert "Agreement" not in page and "true stage" not in re.sub("(?s)<script.*", "", page)


def test_stages_have_the_demonstrators_names_where_there_are_any(content):
    assert content.stage_names == {0: "open drawer", 1: "close drawer"}
    assert replace(content, collection={"stages": ["one"]}).stage_names == {0: "one", 1: "stage 1"}


def test_texts_of_a_dataset_stay_texts(content):
    evil = replace(content, tasks=[(HOSTILE,)] * 3, collection={"stages": [HOSTILE] * 2, "demonstrator": HOSTILE})
    page = render(evil, HOSTILE)
    assert "hacked = 1" in page and "<img src=x" not in page
    assert page.count("<script") == page.count("</script>") == 2
    data = json.loads(re.search('(?s)id="data">(.*?)</script>', page)[1])
    assert data["demonstrations"][0]["tasks"] == [HOSTILE]


def test_nothing_is_asked_of_anybody(content):
    page = render(content, "me/demo")
    assert "default-src 'none'" in page
    assert not re.search(r"""(src|href)="(?!data:|#)""", page) and "@import" not in page and "fetch(" not in page


def test_text_can_be_read_on_every_colour():
    assert [color["text"] for color in skill_colors(12)][:2] == ["#ffffff", "#16191d"]
    assert len({color["fill"] for color in skill_colors(40)}) == 40


def test_a_file_is_made_of_a_segmented_dataset(recorded, tmp_path):
    write_report(tmp_path / "new" / "report.html", recorded, "tests/demos")
    text = (tmp_path / "new" / "report.html").read_text()
    assert text == render(recorded, "tests/demos")
    data = json.loads(re.search('(?s)id="data">(.*?)</script>', text)[1])
    assert [demo["frames"] for demo in data["demonstrations"]] == [len(labels) for labels in recorded.labels]
    for demo, structure in zip(data["demonstrations"], recorded.structures, strict=True):
        assert demo["nodes"][-1][:2] == [0, demo["frames"]]
        assert demo["segments"] == structure.segments[:, 1].tolist() and len(demo["segments"]) > 1


def test_strips_show_evenly_spread_frames(recorded):
    pictures = Pictures(recorded.dataset, recorded.side, 360)
    camera = pictures.cameras[0]
    assert camera.endswith("agentview") and len(pictures.cameras) == 2 and pictures.count == 8
    strip = Image.open(BytesIO(b64decode(pictures.strip(camera, recorded.starts[1], 50).split(",")[1])))
    assert strip.size == (8 * 32, 32) and strip.format == "WEBP"
    frame = Image.open(BytesIO(b64decode(pictures.frame(camera, recorded.starts[1] + 3).split(",")[1])))
    difference = np.asarray(strip.crop((0, 0, 32, 32)), dtype=float) - np.asarray(frame)
    assert middles(50, 8)[0] == 3 and np.abs(difference).mean() < 6


def test_noise_is_no_larger_than_the_budget_allows():
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, 8 * 107, 3), dtype=np.uint8)
    assert len(data_uri(Image.fromarray(noise), 8 * BYTES)) * BUDGET / 8 < 25e6


def test_many_episodes_have_fewer_pictures(recorded):
    assert Pictures(recorded.dataset, recorded.side, 4).count == 16
    many = Pictures(recorded.dataset, recorded.side, 5000)
    assert (many.count, len(many.cameras)) == (4, 1)


def test_middles_of_short_and_long_episodes():
    assert middles(1, 4).tolist() == [0, 0, 0, 0]
    assert middles(8, 4).tolist() == [1, 3, 5, 7]


def test_a_choice_of_episodes_is_shown_alone(segmented):
    chosen = Content.read(LocalDataset(segmented, (2,)))
    assert chosen.numbers == [2] and len(chosen.labels) == len(chosen.stages) == len(chosen.structures) == 1


def test_without_its_representation_there_are_no_trees(segmented, tmp_path, caplog):
    root = tmp_path / "skills"
    shutil.copytree(segmented, root)
    shutil.rmtree(root / REPRESENTATION_DIR)
    found = Content.read(LocalDataset(root))
    assert found.structures is None and "shows no trees" in caplog.text


def test_a_dataset_without_labels_is_refused(demonstrations):
    with pytest.raises(SegmentationError, match="has no segmentation record"):
        Content.read(LocalDataset(demonstrations))
