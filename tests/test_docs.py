"""What the documents promise: the site lists every page, the reference every public name, and every link leads on."""

import re
import runpy
import unicodedata
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SITE = runpy.run_path(str(ROOT / "scripts/docs_site.py"))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")])
LINK = re.compile(r"\]\(<?(?!https?:|mailto:)([^)\s>]*)>?\)|(?:src|href)=\"(?!https?:)([^\"]*)\"")


class Loader(yaml.SafeLoader):
    """Takes what MkDocs reads from the environment for its default."""


Loader.add_constructor("!ENV", lambda loader, node: loader.construct_sequence(node)[-1])


@pytest.fixture(scope="module")
def pages() -> set[str]:
    """The pages that mkdocs.yml lists."""

    def within(entry: object) -> Iterator[str]:
        if isinstance(entry, str):
            yield entry
        for part in entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ():
            yield from within(part)

    listed = list(within(yaml.load((ROOT / "mkdocs.yml").read_text(), Loader)["nav"]))
    assert len(listed) == len(set(listed))
    return set(listed)


def prose(path: Path) -> str:
    """The text without blocks and spans of code, in which brackets are no links."""
    return re.sub(r"`[^`]*`", "", re.sub(r"^( *)```.*?^\1```", "", path.read_text(), flags=re.M | re.S))


def anchors(path: Path) -> set[str]:
    """What the headings are called both on GitHub and on the site."""
    github, site = set[str](), set[str]()
    text = re.sub(r"^( *)```.*?^\1```", "", path.read_text(), flags=re.M | re.S)
    for heading in re.findall(r"^#+ (.+?)\s*$", text, flags=re.M):
        plain = re.sub(r"[`*]|\]\([^)]*\)|\[", "", heading)
        github.add(re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-"))
        ascii_only = unicodedata.normalize("NFKD", plain).encode("ascii", "ignore").decode()
        site.add(re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", ascii_only).strip().lower()))
    return github & site


def test_the_site_lists_every_page_and_no_other(pages: set[str]) -> None:
    written = {str(path.relative_to(ROOT / "docs")) for path in ROOT.glob("docs/**/*.md")}
    assert pages == written | SITE["COPIES"].keys() | SITE["reference_pages"]().keys()


def test_the_reference_names_every_public_name() -> None:
    names = SITE["public_names"]()
    inits = [path for path in (ROOT / "lerobot_buds").rglob("__init__.py") if "__all__" in path.read_text()]
    assert names.keys() == {".".join(path.parent.relative_to(ROOT).parts) for path in inits}
    told = {line.removeprefix("::: ") for page in SITE["reference_pages"]().values() for line in page.splitlines()}
    for package, public in names.items():
        assert public, package
        assert [name for name in public if SITE["place_of"](package, name) not in told] == []


@pytest.mark.parametrize("name", [name for names in SITE["BESIDE"].values() for name in names])
def test_what_is_told_beside_them_exists(name: str) -> None:
    module, _, attribute = name.rpartition(".")
    text = ROOT.joinpath(*module.split(".")).with_suffix(".py").read_text()
    assert re.search(rf"^class {attribute}\b", text, flags=re.M)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_link_leads_somewhere(path: Path) -> None:
    for target in (a or b for a, b in LINK.findall(prose(path))):
        file, _, anchor = target.partition("#")
        goal = (path.parent / file).resolve() if file else path
        assert goal.exists(), target
        assert goal.is_relative_to(ROOT), target
        if goal.is_relative_to(ROOT / "docs") or not path.is_relative_to(ROOT / "docs"):
            assert not anchor or anchor in anchors(goal), target
        else:
            pytest.fail(f"{target} leads out of docs/, where the site has no page")


def test_links_of_a_copied_page_lead_where_they_did(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "![p](docs/p.png) [a](docs/a.md#b) [c](CONTRIBUTING.md) [l](LICENSE) [![b](https://x/y)](LICENSE) [w](https://z)"
    (tmp_path / "README.md").write_text(text)
    monkeypatch.setitem(SITE["copied_page"].__globals__, "ROOT", tmp_path)
    page = SITE["copied_page"]("README.md", "https://r/")
    at = "https://r/blob/main/LICENSE"
    assert page == f"![p](p.png) [a](a.md#b) [c](contributing.md) [l]({at}) [![b](https://x/y)]({at}) [w](https://z)"
    assert SITE["copied_page"]("README.md").endswith("(contributing.md) l ![b](https://x/y) [w](https://z)")
