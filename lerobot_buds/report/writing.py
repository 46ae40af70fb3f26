"""Puts everything into one HTML file. What comes from a dataset is text, and is escaped as such."""

import json
from base64 import b64encode
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from lerobot_buds.core import write_atomically
from lerobot_buds.segmentation import SegmentationRecord
from lerobot_buds.segmentation.timeline import label_colors

from .cards import cards
from .content import Content
from .demonstrations import demonstrations
from .pictures import Pictures
from .scores import scores

PAGE = Path(__file__).parent / "page"


def write_report(path: Path, content: Content, name: str, compared: Mapping[str, Any] | None = None) -> None:
    """Writes the report of a segmentation, atomically; the same content gives the same bytes.

    Args:
        path: The HTML file to create or replace.
        content: What is shown.
        name: Name of the dataset, for the title.
        compared: How other methods agree with the same stages, see `rivals`; None where that is not known.

    Raises:
        DatasetError: Its frames are damaged.
        StorageError: They do not fit into the frame store, or the file cannot be written.
    """
    page = render(content, name, compared)
    write_atomically(path, lambda part: part.write_text(page, encoding="utf-8"))


def render(content: Content, name: str, compared: Mapping[str, Any] | None = None) -> str:
    """Makes the page, see `write_report`."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    templates = Environment(
        loader=FileSystemLoader(PAGE), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    pictures = Pictures(content.dataset, content.side, len(content.numbers))
    script = (PAGE / "report.js").read_text(encoding="utf-8")
    colors = skill_colors(content.record.n_skills)
    scored = scores(content)
    return templates.get_template("report.html.j2").render(
        name=name,
        style=Markup((PAGE / "report.css").read_text(encoding="utf-8")),
        script=Markup(script),
        # The browser runs this script and no other, whatever the texts of a dataset hold.
        script_hash=b64encode(sha256(script.encode()).digest()).decode(),
        colors=colors,
        stages=content.stage_names,
        figures=_figures(content, scored),
        cards=cards(content, pictures),
        scores=scored,
        compared=compared,
        curve=_curve(content.record),
        provenance=_provenance(content),
        data={
            "fps": content.dataset.fps,
            "stages": content.stage_names,
            "cameras": [{"name": c, "size": pictures.sizes[c]} for c in pictures.cameras],
            "count": pictures.count,
            "demonstrations": demonstrations(content, pictures),
        },
    )


def skill_colors(n_skills: int) -> list[dict[str, str]]:
    """Lists the colour of every skill, as in the pictures of `draw_timeline`, and that of text on it."""
    return [
        {
            "fill": "#" + "".join(f"{round(255 * part):02x}" for part in (red, green, blue)),
            "text": "#16191d" if 0.299 * red + 0.587 * green + 0.114 * blue > 0.6 else "#ffffff",
        }
        for red, green, blue, _ in label_colors(range(n_skills), "skills").values()
    ]


def _figures(content: Content, scored: Mapping[str, Any] | None) -> list[tuple[str, str, str]]:
    """Name, value and remark of the figures on top."""
    record, fps = content.record, content.dataset.fps
    frames, count = sum(map(len, content.labels)), len(content.labels)
    segments = sum(len(record.episodes[number].segments) for number in content.numbers)
    found = [
        ("demonstrations", f"{count:,}", f"{frames:,} frames at {fps:g} Hz"),
        ("recorded", f"{frames / fps / 60:.1f} min", f"{frames / fps / count:.1f} s each"),
        ("skills", str(record.n_skills), "lasting " + f"{frames / segments / fps:.1f} s on average"),
        ("segments each", f"{segments / count:.1f}", f"{segments:,} in all"),
    ]
    if record.stability is not None:
        advice = "holds when data differ slightly" if record.stability >= 0.7 else "below 0.7: record more"
        found.append(("stability", f"{record.stability:.2f}", advice))
    if scored is not None:
        by_name = {name: value for name, value, _ in scored["scores"]}
        found += [
            ("NMI", by_name["NMI"], "against the true stages"),
            ("boundary F1", by_name["Boundary F1"], scored["within"]),
        ]
    return found


def _curve(record: SegmentationRecord) -> list[dict[str, Any]]:
    """How well each number of skills parts the segments, where the number was chosen."""
    points = sorted((int(count), score) for count, score in (record.silhouettes or {}).items())
    best = max((score for _, score in points), default=0.0)
    return [
        {"count": count, "score": score, "bar": max(0.0, score / best) if best > 0 else 0.0, "best": score == best}
        for count, score in points
    ]


def _provenance(content: Content) -> dict[str, dict[str, str]]:
    """What the labels come from, as texts under headings."""
    record = content.record
    origin = {
        "source": record.source.repo_id,
        "episodes": f"{len(record.episodes)}, {record.source.total_frames:,} frames",
        "subgoal horizon": f"{record.horizon / record.source.fps:g} s",
        "written by": f"lerobot_policy_buds {record.package_version}",
        "labels": record.labels_hash,
        "library": "none" if record.library is None else str(record.library.get("name")),
        **{f"seed of {stage}": str(seed) for stage, seed in record.seeds.items()},
        **{key: str(content.collection[key]) for key in ("demonstrator", "manner") if key in content.collection},
    }
    return {
        "Origin": origin,
        "Skill discovery": _texts(record.parameters),
        "Representation": _texts(record.representation),
    }


def _texts(settings: Mapping[str, Any]) -> dict[str, str]:
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in sorted(settings.items())}
