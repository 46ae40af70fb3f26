"""The page in a browser: no error, no request, every interaction. Chromium comes with scripts/setup.sh."""

from dataclasses import replace
from functools import cache

import pytest

from lerobot_buds.report import write_report
from lerobot_buds.report.pictures import Pictures

from .browser import CHROMIUM, Browser
from .test_report import HOSTILE

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: sudo apt-get install chromium")

CURRENT = "document.querySelector('[aria-current]').dataset.place"
TIME = "Number(document.getElementById('plot').getAttribute('aria-valuenow'))"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture
def page(browser, tmp_path):
    """Opens a report; whatever was done with it, it must not have complained or asked for anything but itself."""
    files = []

    def open_report(content):
        files.append(tmp_path / f"{len(files)}.html")
        write_report(files[-1], content, "tests/demos")
        browser.complaints.clear()
        browser.requests.clear()
        browser.resize(1280, 900)
        browser.open(files[-1])
        return browser

    yield open_report
    assert browser.complaints == []
    assert browser.requests == [file.as_uri() for file in files]


def visible(browser, selector):
    """Number of elements of a selector that take room."""
    return browser.run(f"[...document.querySelectorAll('{selector}')].filter((e) => e.offsetParent).length")


def test_a_recorded_dataset_is_drawn(page, recorded):
    browser = page(recorded)
    count = len(recorded.labels)
    assert browser.run("document.querySelectorAll('.row').length") == count
    assert browser.run("[...document.images].every((i) => i.complete && i.naturalWidth)")
    assert visible(browser, ".row img") == count and visible(browser, "#frames div") == 2
    assert browser.run("document.querySelectorAll('#plot path').length") > 3
    runs = sum(len(recorded.record.episodes[n].segments) for n in recorded.numbers)
    assert browser.run("document.querySelectorAll('.row .ribbon.skill i').length") == runs


def test_arrows_go_through_demonstrations_and_time(page, content):
    browser = page(content)
    assert browser.run(CURRENT) == "0"
    for key, place in (("ArrowDown", "1"), ("ArrowDown", "2"), ("ArrowDown", "2"), ("ArrowUp", "1"), ("Home", "0")):
        browser.press(key)
        assert browser.run(CURRENT) == place
    browser.press("End")
    assert browser.run("document.getElementById('which').textContent") == "Demonstration 2, 1.0 s"
    assert browser.run("document.getElementById('task').textContent") == "make tea"
    assert browser.run(TIME) == 0
    for _ in range(20):
        browser.press("ArrowRight")
    assert browser.run(TIME) == 9
    assert browser.run("document.querySelector('#readout').textContent").endswith("true stageclose drawer")
    browser.press("ArrowLeft")
    assert browser.run(TIME) == 8


def test_arrows_scroll_where_no_demonstration_is_in_sight(page, content):
    browser = page(content)
    browser.resize(1280, 300)
    browser.run("scrollTo(0, document.documentElement.scrollHeight)")
    browser.press("ArrowDown")
    assert browser.run(CURRENT) == "0"


def test_tab_goes_through_demonstrations(page, content):
    browser = page(content)
    browser.run("document.querySelector('.row').focus()")
    browser.press("Tab")
    assert browser.run(CURRENT) == "1" == browser.run("document.activeElement.dataset.place")
    browser.press("ArrowDown")
    assert browser.run("document.activeElement.dataset.place") == "2"


def test_mouse_chooses_demonstration_and_time(page, content):
    browser = page(content)
    browser.click(".row[data-place='1']")
    assert browser.run(CURRENT) == "1"
    browser.click("#next")
    assert browser.run(CURRENT) == "2"
    browser.click("#previous")
    browser.click("#plot")
    assert browser.run(CURRENT) == "1" and browser.run(TIME) == 4


def test_an_example_leads_to_its_place(page, content):
    browser = page(content)
    browser.click(".skill.k2 .example")
    assert browser.run(CURRENT) == "1" and browser.run(TIME) == 2


def test_a_skill_is_highlighted(page, content):
    browser = page(content)
    opacity = "[...document.querySelectorAll('.row[data-place=\"0\"] .run')].map((e) => getComputedStyle(e).opacity)"
    browser.click("nav [data-skill='1']")
    assert browser.run(opacity) == ["0.1", "1"]
    assert browser.run("document.querySelector('[aria-pressed=true]').dataset.skill") == "1"
    browser.click("nav [data-skill='0']")
    assert browser.run(opacity) == ["1", "0.1"]
    browser.press("Escape")
    assert browser.run(opacity) == ["1", "1"] and not browser.run("!!document.querySelector('[aria-pressed=true]')")


def test_the_list_is_filtered_and_ordered(page, content):
    browser = page(content)
    places = "[...document.querySelectorAll('.row')].map((row) => row.dataset.place).join('')"

    def select(name, value):
        browser.run(f"byId('{name}').value = '{value}'; byId('{name}').dispatchEvent(new Event('change'))")
        return browser.run(places)

    assert select("order", "frames") == "102"
    assert select("order", "skills") == "021"
    assert select("tasks", "make tea") == "2" and browser.run(CURRENT) == "2"
    browser.press("ArrowUp")
    assert browser.run(CURRENT) == "2"
    assert select("tasks", "") == "021"


def test_pictures_ribbons_and_scale(page, recorded):
    browser = page(recorded)
    browser.click("#look label:nth-of-type(2)")
    assert visible(browser, ".row img") == 0
    widths = "[...document.querySelectorAll('.row .ribbon.skill')].map((e) => e.getBoundingClientRect().width)"
    assert len(set(browser.run(widths))) == 1
    browser.click("#look label:nth-of-type(3)")
    lengths, shown = [len(labels) for labels in recorded.labels], browser.run(widths)
    assert [w / max(shown) for w in shown] == pytest.approx([n / max(lengths) for n in lengths], abs=0.01)


def test_it_fits_a_phone(page, recorded):
    browser = page(recorded)
    browser.resize(360, 740, mobile=True)
    assert browser.run("document.documentElement.scrollWidth") == 360
    viewer, rows = browser.run("['.viewer', '.list'].map((s) => document.querySelector(s).getBoundingClientRect().top)")
    assert viewer < rows


def test_dark_and_light(page, content):
    browser = page(content)
    shades = []
    for dark in (True, False):
        browser.dark(dark)
        shades.append(browser.run("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"))
    assert max(shades[0]) < 60 and min(shades[1]) > 200


def test_texts_of_a_dataset_do_nothing(page, content):
    stages = {"stages": [HOSTILE] * 2, "demonstrator": HOSTILE}
    browser = page(replace(content, tasks=[(HOSTILE,), (HOSTILE + "2",), (HOSTILE,)], collection=stages))
    browser.press("ArrowDown")
    assert browser.run("typeof hacked") == "undefined"
    assert browser.run("document.getElementById('task').textContent") == HOSTILE + "2"
    assert browser.run("document.querySelector('#plot .stage i').textContent") == HOSTILE
    assert browser.run("document.querySelectorAll('img').length") == 0


def test_360_demonstrations_are_small_and_quick(recorded, browser, tmp_path, monkeypatch):
    monkeypatch.setattr(Pictures, "strip", cache(Pictures.strip))
    parts = ("numbers", "starts", "labels", "tasks", "stages", "structures")
    many = replace(recorded, **{name: getattr(recorded, name) * 90 for name in parts})
    write_report(tmp_path / "many.html", many, "tests/many")
    assert (tmp_path / "many.html").stat().st_size < 25e6
    assert min(browser.open(tmp_path / "many.html") for _ in range(3)) < 3
    assert browser.run("document.querySelectorAll('.row').length") == 360
