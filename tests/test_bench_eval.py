"""How long `hiermap eval` takes on a building of 200 rooms, and before it begins."""

from __future__ import annotations

import subprocess
import sys

import pydantic_core
import pytest
from large_building import boxes, model_of, path_through, reference_of

from hiermap_cli.documents.reference import reference_document
from hiermap_cli.documents.results import write_result
from hiermap_cli.documents.trajectories import write_tum
from hiermap_cli.mapping.model import MapResult

pytestmark = pytest.mark.bench


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    """A folder with a run, its truth and its reference: 200 rooms, 5 corridors, 820 corners."""
    folder = tmp_path_factory.mktemp("building")
    areas = boxes(5, 20)
    reference, track = reference_of(areas), path_through(areas)
    model = model_of(areas, reference)
    (folder / "run").mkdir()
    write_result(folder / "run", MapResult(model, track, track, (), (), {}, {}))
    with (folder / "truth.tum").open("w") as file:
        write_tum(file, track.stamps_ns, track.poses)
    (folder / "reference.json").write_bytes(pydantic_core.to_json(reference_document(reference)))
    return folder


def command(*arguments):
    done = subprocess.run(
        [sys.executable, "-m", "hiermap_cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_bench_eval_of_200_rooms(building, benchmark):
    arguments = ("eval", building / "run", "--reference", building / "reference.json")
    truth = ("--trajectory", building / "truth.tum")
    benchmark.pedantic(command, args=(*arguments, *truth, "-q"), rounds=3)


def test_bench_eval_of_200_rooms_aligned_by_the_maps(building, benchmark):
    arguments = ("eval", building / "run", "--reference", building / "reference.json", "-q")
    benchmark.pedantic(command, args=arguments, rounds=2)


def test_bench_eval_start(benchmark):
    benchmark.pedantic(command, args=("eval", "--help"), rounds=3)
