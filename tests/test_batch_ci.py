"""What the docs give to copy into CI: it parses, and its own command does what it says."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
import yaml
from batch_cases import batch, results
from click.testing import CliRunner

from hiermap_cli.commands.main import cli

ROOT = Path(__file__).resolve().parents[1]
CI = ROOT / "docs" / "ci"


def steps_of_github() -> list[dict]:
    workflow = yaml.safe_load((CI / "github-actions.yml").read_text())
    [job] = workflow["jobs"].values()
    return job["steps"]


def job_of_gitlab() -> dict:
    [job] = yaml.safe_load((CI / "gitlab-ci.yml").read_text()).values()
    return job


def commands() -> list[str]:
    found = [step["run"] for step in steps_of_github() if "run" in step]
    return [line for line in [*found, *job_of_gitlab()["script"]] if line.startswith("hiermap")]


@pytest.fixture(scope="module")
def published(tmp_path_factory):
    """The batch of the workflow, and of the job of GitLab, which is the same."""
    [command] = set(commands())
    words = shlex.split(command)
    assert words[:2] == ["hiermap", "batch"]
    place = tmp_path_factory.mktemp("checkout")
    for name in ("datasets", "configs"):
        (place / name).symlink_to(ROOT / name)
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    return place, batch(*words[2:], "--workers", 2, cwd=place, env=environment)


def test_the_workflow_runs_a_batch_that_holds_its_limits(published):
    place, done = published
    assert done.returncode == 0, done.stderr
    assert set(results(place / "out")) == {"room", "doors/ring/log", "doors/room_corridor/log"}


def test_what_is_published_is_there(published):
    place, _ = published
    gitlab = job_of_gitlab()["artifacts"]
    paths = [*gitlab["paths"], gitlab["reports"]["junit"], "out/summary.md"]
    for step in steps_of_github():
        options = step.get("with", {})
        paths += [options[key] for key in ("path", "report_paths") if key in options]
    for path in paths:
        assert (place / path).exists(), path


def test_steps_that_publish_run_whatever_happened():
    steps = steps_of_github()
    [at] = [i for i, step in enumerate(steps) if "hiermap batch" in step.get("run", "")]
    assert "if" not in steps[at]
    assert {step["if"] for step in steps[at + 1 :]} == {"always()"}
    assert job_of_gitlab()["artifacts"]["when"] == "always"
    assert not any(step.get("continue-on-error") for step in steps)


def test_every_document_of_a_batch_is_valid(published):
    place, _ = published
    out = place / "out"
    folders = [str(path.parent) for path in out.rglob("job.json")]
    done = CliRunner().invoke(cli, ["validate", str(out), str(ROOT / "datasets"), *folders])
    assert done.exit_code == 0, done.output
    assert "hiermap-summary" in done.output
    assert "valid hiermap-job" in done.output
    assert "jobs.yaml: valid jobs" in done.output


def test_a_limit_that_is_missed_fails_the_job(published, tmp_path):
    place, _ = published
    jobs = (place / "datasets" / "jobs.yaml").read_text()
    strict = re.sub(r"ate_rmse<=[0-9.]+", "ate_rmse<=0.000001", jobs)
    assert strict != jobs
    for path in (place / "datasets").iterdir():
        if path.is_dir():
            (tmp_path / path.name).symlink_to(path.resolve())
    (tmp_path / "jobs.yaml").write_text(strict)
    shutil.copytree(place / "out", tmp_path / "out")  # as CI restores what it has kept
    done = batch(tmp_path / "jobs.yaml", "-o", tmp_path / "out", "--workers", 2)
    assert done.returncode == 3, done.stderr
    assert "limit missed: ate_rmse<=0.000001: it is 0.0" in done.stderr


def test_our_own_ci_runs_it():
    assert "make batch" in (ROOT / ".ci" / "run").read_text()
    makefile = (ROOT / "Makefile").read_text()
    assert "hiermap batch datasets/jobs.yaml" in makefile


def test_the_job_array_in_the_docs_is_the_file_beside_it():
    lines = (CI / "slurm.sh").read_text().splitlines()
    assert len(lines) == 6
    page = (ROOT / "docs" / "batch.md").read_text()
    assert "\n".join(f"    {line}" for line in lines) in page


def test_validate_finds_the_faults_that_a_batch_would(tmp_path):
    (tmp_path / "jobs.yaml").write_text(
        "jobs:\n  - {name: a, log: '*.mcap'}\n  - {name: b, log: b.mcap, limits: [x]}\n"
    )
    done = CliRunner().invoke(cli, ["validate", str(tmp_path / "jobs.yaml")])
    assert done.exit_code == 2
    assert "line 2: jobs[0].log: no log fits *.mcap" in done.stderr
    assert "line 3: jobs[1].limits[0]" in done.stderr


def test_a_damaged_record_is_not_valid(published, tmp_path):
    place, _ = published
    record = json.loads((place / "out" / "room" / "job.json").read_text())
    del record["inputs"]["log"]["sha256"]
    (tmp_path / "job.json").write_text(json.dumps(record))
    done = CliRunner().invoke(cli, ["validate", str(tmp_path / "job.json")])
    assert done.exit_code == 1
    assert "inputs.log.sha256: is missing" in done.stderr
