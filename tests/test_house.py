"""The rules of the house: who may import whom, how long a file may be, what must be documented."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import click
import pytest

from hiermap_cli.commands.main import COMMANDS, cli

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hiermap_cli"

# From the top down: each imports only from those below it.
FOLDERS = [
    "commands",
    "batch",
    "figures",
    "evaluation",
    "simulation",
    "documents",
    "mapping",
    "perception",
    "estimation",
    "logs",
    "geometry",
]
# The same within `mapping`: its folders and the modules beside them.
MAPPING = [
    "run",
    "assembly",
    "trust",
    "areas",
    "refinement",
    "loops",
    "levels",
    "filtering",
    "mapper",
    "taken",
    "topology",
    "odometry",
    "association",
    "keyscans",
    "trail",
    "repeats",
    "metrics",
    "environment",
    "portals",
    "area_map",
    "model",
]
# Modules beside the folders: at the bottom, but for the entry point.
BOTTOM = [
    "configtext",
    "configfile",
    "faults",
    "config",
    "config_mapping",
    "config_fields",
    "errors",
    "__init__",
]
HEAVY = {"numpy", "scipy", "pydantic", "rich", "mcap", "rosbags", "yaml", "shapely", "matplotlib"}
MAY_TOUCH_THE_DISK = {"logs", "documents", "config", "batch", "commands"}

MODULES = sorted(PACKAGE.rglob("*.py"))


def at_root(path: Path) -> str:
    return str(path.relative_to(ROOT))


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(path: Path) -> set[str]:
    """Every module of the project that a file imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.split(".")[0] == "hiermap_cli"}


def rank(module: str) -> int | None:
    """How high a module stands; None for the package itself."""
    parts = module.split(".")
    if len(parts) == 1:
        return None
    if parts[1] in FOLDERS:
        return len(FOLDERS) - FOLDERS.index(parts[1]) + len(BOTTOM)
    if parts[1] in BOTTOM:
        return len(BOTTOM) - BOTTOM.index(parts[1])
    return None


def test_every_folder_is_ranked():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders <= set(FOLDERS)
    beside = {path.stem for path in PACKAGE.glob("*.py")}
    assert beside <= {*BOTTOM, "__main__"}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_go_down_only(path):
    own = name_of(path)
    if own == "hiermap_cli.__main__":
        return
    own_rank = rank(own)
    for imported in imports_of(path):
        other = rank(imported)
        if other is None or imported.split(".")[1] == own.split(".")[1 if "." in own else 0]:
            continue
        assert own_rank is not None, f"{own} imports {imported}"
        assert other < own_rank, f"{own} imports {imported}, which stands above it"


def test_every_part_of_mapping_is_ranked():
    parts = {path.stem for path in (PACKAGE / "mapping").iterdir() if path.name[0] not in "_."}
    assert parts == set(MAPPING)


@pytest.mark.parametrize("path", sorted((PACKAGE / "mapping").rglob("*.py")), ids=name_of)
def test_imports_within_mapping_go_down_only(path):
    own = name_of(path).split(".")
    for imported in imports_of(path):
        parts = imported.split(".")
        if len(own) > 2 and parts[1:2] == ["mapping"] and len(parts) > 2 and parts[2] != own[2]:
            higher = MAPPING.index(own[2]) > MAPPING.index(parts[2])
            assert not higher, f"{'.'.join(own)} imports {imported}, which stands above it"


@pytest.mark.parametrize("path", MODULES + sorted((ROOT / "tests").rglob("*.py")), ids=at_root)
def test_no_file_is_too_long(path):
    assert len(path.read_text().splitlines()) <= 400


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_only_some_folders_touch_the_disk(path):
    parts = name_of(path).split(".")
    if len(parts) < 2 or parts[1] in MAY_TOUCH_THE_DISK | {"configfile", "__main__"}:
        return
    touching = {"open", "read_text", "write_text", "read_bytes", "write_bytes", "mkdir", "unlink"}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            function = node.func
            called = function.attr if isinstance(function, ast.Attribute) else None
            called = function.id if isinstance(function, ast.Name) else called
            assert called not in touching, f"{path}:{node.lineno}: {called}"


# --- what a run may know ---


def reachable(start: str) -> set[Path]:
    """Every file of the project that `start` imports, directly or through others."""
    files = {name_of(path): path for path in MODULES}
    waiting, seen = [start], set()
    while waiting:
        module = waiting.pop()
        if module in files and module not in seen:
            seen.add(module)
            waiting += imports_of(files[module])
    return {files[module] for module in seen}


def test_a_run_reads_no_truth():
    files = reachable("hiermap_cli.commands.run")
    assert PACKAGE / "batch" / "run_log.py" in files
    for path in files:
        text = path.read_text()
        for word in ("slam_reference", "relations.txt", "read_relations", "truth.tum"):
            assert word not in text, f"{path} speaks of {word}"
        assert path.parent.name not in ("evaluation", "simulation"), path


def test_no_random_numbers_but_from_a_generator_passed_in():
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Attribute):
                is_global = node.value.attr == "random" and node.attr not in (
                    "Generator",
                    "default_rng",
                )
                assert not is_global, f"{path}:{node.lineno}: np.random.{node.attr}"


# --- the command line ---


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_and_docs(name):
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    assert command.help
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.help, f"hiermap {name} {parameter.opts[0]} has no help"
    usage = (ROOT / "docs" / "usage.md").read_text()
    assert re.search(rf"^## .*`hiermap {name}\b", usage, re.MULTILINE)
    for parameter in command.params:
        if isinstance(parameter, click.Option):
            assert parameter.opts[-1] in usage, f"{parameter.opts[-1]} is not in docs/usage.md"


def loaded_by(code: str) -> set[str]:
    """Top-level modules that are loaded after `code` in an interpreter of its own."""
    script = f"import sys\n{code}\nprint(*sorted({{m.split('.')[0] for m in sys.modules}}))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_help_loads_nothing_heavy():
    code = """
sys.argv = ["hiermap", "--help"]
from hiermap_cli.commands import main
import contextlib, io
with contextlib.redirect_stdout(io.StringIO()):
    try:
        main.main()
    except SystemExit as error:
        assert error.code == 0
"""
    assert not loaded_by(code) & HEAVY


def test_commands_load_nothing_heavy_before_they_run():
    imports = "\n".join(f"import hiermap_cli.commands.{name}" for name in COMMANDS)
    assert not loaded_by(imports) & HEAVY


def test_the_filter_alone_runs_without_what_takes_long_to_load(tmp_path):
    (tmp_path / "filter.yaml").write_text("refine:\n  enabled: false\n")
    log = ROOT / "datasets" / "ring" / "log.mcap"
    options = ["--end", "5", "--quiet", "--config", str(tmp_path / "filter.yaml")]
    code = f"""
sys.argv = ["hiermap", "run", {str(log)!r}, "-o", {str(tmp_path / "out")!r}, *{options!r}]
from hiermap_cli.commands import main
try:
    main.main()
except SystemExit as error:
    assert error.code == 0
"""
    assert not loaded_by(code) & {"http", "rich", "scipy"}
    assert (tmp_path / "out" / "model.json").exists()


def test_one_thread_is_set_before_numpy_is_loaded():
    code = """
import os, hiermap_cli.commands.main as m
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "7"
seen = {}
m._run = lambda arguments: seen.update(os.environ) or 0
assert "numpy" not in sys.modules
try:
    m.main()
except SystemExit:
    pass
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    assert seen[name] == "1"
"""
    assert "numpy" not in loaded_by(code)


# --- the repository ---


def test_ci_calls_the_test_command_of_the_readme():
    readme = (ROOT / "README.md").read_text()
    assert "make test" in readme
    assert "make demo" in readme
    assert "make test" in (ROOT / ".ci" / "run").read_text()


def test_every_target_of_the_makefile_is_explained():
    makefile = (ROOT / "Makefile").read_text()
    targets = re.search(r"^\.PHONY: (.*)$", makefile, re.MULTILINE).group(1).split()
    for target in set(targets) - {"help", "setup"}:
        assert f"make {target}" in makefile, target
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
