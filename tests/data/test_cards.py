"""Anybody's text on a card: neither HTML nor Markdown, nor the end of a line or of a block of code."""

import pytest
from jinja2 import UndefinedError

from lerobot_buds.data import render_card

NASTY = "<script>alert(1)</script> | [x](http://evil) `a`\n# title ![i](u) *b* \\"


def card(**changes: object) -> str:
    values = {
        "backbone": None,
        "weights": "",
        "cameras": [(NASTY, 32, 24)],
        "state": ["x", NASTY],
        "parent": {},
        "kept": 5,
        "last": 10,
        "losses": [("loss", 3.0, 2.25)],
        "repo_id": NASTY + "```",
    }
    return render_card("representation", **(values | changes))


def test_text_means_nothing_to_html_and_markdown() -> None:
    lines = card().splitlines()
    (camera,) = [line for line in lines if "32 x 24 pixels" in line]
    assert camera.count("|") == 3 and not set("<>[]`*!\\") & set(camera)
    assert "script&#62;" in camera
    assert [line for line in lines if line.startswith("#")] == ["# A representation of demonstrations"]


def test_code_ends_where_the_template_ends_it() -> None:
    text = card()
    assert text.count("```") == 2 and "--representation_path=<script>" in text.split("```")[1]
    assert text.split("```")[1].strip().count("\n") == 0


def test_a_value_that_is_missing_is_an_error() -> None:
    with pytest.raises(UndefinedError):
        render_card("representation", backbone=None)


def test_figures_are_rounded() -> None:
    assert "| loss | 3 | 2.25 |" in card() and "Kept at step 5 of 10." in card()
