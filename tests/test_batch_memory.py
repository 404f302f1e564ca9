"""Peak memory is that of one job, in a worker that has done others; the hard stop holds."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from batch_cases import batch, jobs_of, small_log, small_logs, summary

from hiermap_cli.batch import memory
from hiermap_cli.batch.memory import begin_job, peak_bytes, resident_bytes, set_hard_stop

pytestmark = pytest.mark.skipif(not memory.can_watch(), reason="no /proc here")
MEGABYTE = 1_000_000


def in_a_process(code: str) -> str:
    script = "from hiermap_cli.batch.memory import *\nimport numpy as np, os\n" + code
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return done.stdout


def test_a_peak_is_forgotten_when_the_next_job_begins():
    begin_job(None)
    first = peak_bytes()
    block = np.ones(20 * MEGABYTE)  # 160 MB
    del block
    grown = peak_bytes()
    begin_job(None)
    assert grown > first + 150 * MEGABYTE
    assert peak_bytes() < grown - 100 * MEGABYTE


@pytest.mark.slow
def test_peaks_of_jobs_in_one_worker(tmp_path):
    first, last = small_logs(tmp_path, 2)
    large = small_log(tmp_path / "large.log", turn=5)
    scan = large.read_text()
    large.write_text(scan + "FLASER 2000000 " + "1.25 " * 2_000_000 + "0 0 0 0 0 0 9 h 9\n")
    jobs = jobs_of([first, large, last], tmp_path / "jobs.yaml")
    batch(jobs, "-o", tmp_path / "out", "--workers", 1)
    rows = summary(tmp_path / "out")
    assert rows["log1"]["peak_memory"] < rows["log0"]["peak_memory"] + 15 * MEGABYTE
    peak = rows["large"]["peak_memory"]
    assert peak is None or peak > rows["log1"]["peak_memory"]


def test_a_request_far_above_the_limit_is_refused_at_once():
    said = in_a_process(
        "begin_job(100_000_000)\n"
        "try:\n    np.zeros(10**12)\n"
        "except MemoryError:\n    print('refused', resident_bytes(os.getpid()) < 150_000_000)\n"
    )
    assert said == "refused True\n"


def test_the_stop_is_lifted_for_the_next_job():
    said = in_a_process(
        "begin_job(50_000_000)\nset_hard_stop(None)\nprint(np.ones(40_000_000).size)\n"
    )
    assert said == "40000000\n"


def test_a_limit_leaves_room_for_what_is_reserved_and_not_filled():
    said = in_a_process("begin_job(200_000_000)\nprint(np.zeros(40_000_000).size)\n")
    assert said == "40000000\n"


def test_a_process_that_is_gone_holds_nothing():
    assert resident_bytes(2**22 + 1) is None
    set_hard_stop(None)
