"""What stands around the code: workflows, templates, the Dockerfile and the citation name what there is."""

import json
import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator
from datetime import date
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
GITHUB = ROOT / ".github"
WORKFLOWS = sorted((GITHUB / "workflows").glob("*.yml"))
PROGRAMS = {"grep", "test", "sudo", "uv"}  # of GitHub's machines, or installed by a line before


def apt_packages(text: str) -> set[str]:
    """The packages that a text has `apt-get install`, every time the same."""
    (line,) = {packages for _, packages in re.findall(r"apt-get install ((?:--?\S+ )*)([a-z0-9 .-]+)", text)}
    return set(line.split())


@pytest.fixture(scope="module")
def needed() -> set[str]:
    """The system packages that docs/install.md names."""
    return apt_packages((ROOT / "docs/install.md").read_text().split("## System packages")[1].split("## When")[0])


def steps(path: Path) -> Iterator[dict]:
    for job in yaml.safe_load(path.read_text())["jobs"].values():
        yield from job["steps"]


def commands(path: Path) -> list[list[str]]:
    """Every command that a workflow runs, in words."""
    lines = [line for step in steps(path) for line in step.get("run", "").splitlines()]
    return [shlex.split(line) for line in lines]


def test_there_are_the_workflows_of_a_public_project() -> None:
    assert [path.stem for path in WORKFLOWS] == ["canary", "ci", "docs", "release"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_calls_what_exists(path: Path) -> None:
    content = yaml.safe_load(path.read_text())
    assert content["permissions"]["contents"] == "read"
    for job in content["jobs"].values():
        needs = job.get("needs", [])
        assert {needs} if isinstance(needs, str) else set(needs) <= content["jobs"].keys()
    for step in steps(path):
        assert ("run" in step) != ("uses" in step)
        assert re.fullmatch(r"[\w.-]+/[\w./-]+@[\w./]+", step.get("uses", "a/b@v1"))
    for program, *words in commands(path):
        if "/" in program:
            assert (ROOT / program).is_file() and (ROOT / program).stat().st_mode & 0o100, program
        elif program == "make":
            assert re.search(rf"^{words[0]}:", (ROOT / "Makefile").read_text(), flags=re.M), words
        elif program == "python":
            assert words[0] == "-m" and find_spec(words[1]), words
        else:
            assert program in PROGRAMS, program


def test_system_packages_are_the_same_everywhere(needed: set[str]) -> None:
    needed = needed - {"chromium", "xvfb", "xdotool"}  # for tests alone: set-up installs them apart
    assert len(needed) == 4
    setup = (ROOT / "scripts/setup.sh").read_text()
    assert set(re.findall(r"wanted=\(([^)]*)\)", setup)[0].split()) == needed
    assert apt_packages((ROOT / "Dockerfile").read_text()) == needed
    for name in ("ci", "canary"):
        assert apt_packages((GITHUB / f"workflows/{name}.yml").read_text()) == needed


def test_the_site_is_built_in_one_way() -> None:
    (built,) = (" ".join(words) for words in commands(GITHUB / "workflows/docs.yml") if words[0] == "uv")
    (made,) = re.findall(r"^docs:.*\n\t(.*)$", (ROOT / "Makefile").read_text(), flags=re.M)
    assert made.replace("$(BIN)/", "").replace("--python python ", "") == built
    assert "docs" in tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]


def test_the_canary_knows_what_it_is_asked_to_try() -> None:
    (job,) = yaml.safe_load((GITHUB / "workflows/canary.yml").read_text())["jobs"].values()
    script = (ROOT / "scripts/canary.sh").read_text()
    assert set(job["strategy"]["matrix"]["package"]) == set(re.findall(r"^  (\w+)\) newest=", script, flags=re.M))
    done = subprocess.run([ROOT / "scripts/canary.sh", "numpy"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "canary: there is no numpy to try\n")


@pytest.mark.parametrize("open_issues", ["", "The newest lerobot does not pass"])
def test_a_failing_canary_opens_one_issue(open_issues: str, tmp_path: Path) -> None:
    """A stand-in for gh notes its arguments and lists the issues that are open."""
    gh = tmp_path / "gh"
    gh.write_text('#!/bin/sh\nprintf "%s\\n" "$1 $2" >>"$NOTES"\n[ "$1 $2" != "issue list" ] || echo "$OPEN"\n')
    gh.chmod(0o755)
    environment = {"PATH": f"{tmp_path}:/usr/bin:/bin", "NOTES": str(tmp_path / "notes"), "OPEN": open_issues}
    script = ROOT / "scripts/report_canary.sh"
    subprocess.run([script, "lerobot"], env=environment | {"RUN": "https://run"}, check=True, capture_output=True)
    asked = (tmp_path / "notes").read_text().splitlines()
    assert asked == ["label create", "issue list", *([] if open_issues else ["issue create"])]


def test_the_container_installs_what_the_documents_name() -> None:
    text = (ROOT / "Dockerfile").read_text().replace("\\\n", " ")
    runs = re.findall(r"^RUN (.*)$", text, flags=re.M)
    for run in runs:
        subprocess.run(["sh", "-n", "-c", run], check=True)
    documented = re.findall(r"^pip install (.*)$", (ROOT / "docs/install.md").read_text(), flags=re.M)
    assert documented == [".", "'.[sim]'", "--no-deps robosuite==1.5.1"]
    assert all(any(wanted in run for run in runs) for wanted in documented[1:])
    for copied in re.findall(r"^COPY (.*) \S+$", text, flags=re.M):
        assert [name for name in copied.split() if not (ROOT / name).exists()] == []
    assert "FROM python:3.12-" in text
    command = json.loads(re.findall(r"^CMD (.*)$", text, flags=re.M)[0])
    assert command[0] in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]


def test_issue_templates_ask_what_helps() -> None:
    forms = {path.stem: yaml.safe_load(path.read_text()) for path in (GITHUB / "ISSUE_TEMPLATE").glob("*.yml")}
    assert forms.keys() == {"bug", "config", "feature"}
    for name in ("bug", "feature"):
        assert forms[name]["name"] and forms[name]["description"]
        ids = [part["id"] for part in forms[name]["body"]]
        assert len(ids) == len(set(ids))
        assert all(part["attributes"]["label"] for part in forms[name]["body"])
    assert any("lerobot-buds-doctor" in part["attributes"]["label"] for part in forms["bug"]["body"])


def test_the_version_is_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == version
    assert citation["references"][0]["doi"].startswith("10.1109/LRA.")
    titles = re.findall(r"^## (.*)$", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)
    released = [title.split(" - ") for title in titles if title != "Unreleased"]
    assert all(date.fromisoformat(day) for _, day in released)
    assert version in [title[0] for title in released] or titles[0] == "Unreleased"
