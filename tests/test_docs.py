"""Every example of the README and of docs/ runs, and every link leads somewhere."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(([^)#]+)")


def examples(page: Path) -> list[tuple[str, str]]:
    """The blocks of a page that are marked as something that runs: sh and python."""
    return [(kind, code) for kind, code in BLOCK.findall(page.read_text()) if kind]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder that looks like a checkout, and an environment that finds this hiermap."""
    folder = tmp_path_factory.mktemp("docs")
    for name in ("datasets", "configs"):
        (folder / name).symlink_to(ROOT / name)
    programs = folder / "bin"
    programs.mkdir()
    for name, target in (("hiermap", "-m hiermap_cli"), ("python3", "")):
        script = programs / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" {target} "$@"\n')
        script.chmod(0o755)
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"
    return folder, {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_run(page, place, tmp_path):
    folder, environment = place
    for kind, code in examples(page):
        assert kind in ("sh", "python"), f"{page.name}: what is a block of {kind}?"
        if kind == "sh":
            command = ["bash", "-euo", "pipefail", "-c", code]
        else:
            command = [sys.executable, "-c", code]
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{page.name}:\n{code}\n{done.stdout}\n{done.stderr}"
    for leftover in folder.glob("*.hiermap"):
        leftover.rename(tmp_path / leftover.name)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in LINK.findall(page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_pages_have_examples():
    counted = {page.name: len(examples(page)) for page in PAGES}
    assert counted["README.md"] >= 2
    assert counted["usage.md"] >= 8
