"""Cost of segmentation a scan, in blocks as `run` makes them; processor time, no limit held here.

`make bench` writes it down as JSON, `microseconds_per_scan` among the extra figures.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from real_data import DATA
from scan_cases import HALF, ROOM, block, scans

from hiermap_cli.config import InputConfig, LaserConfig, SegmentationConfig
from hiermap_cli.logs.recording import open_recording
from hiermap_cli.perception.segmentation import segment_block

pytestmark = pytest.mark.bench

FR079 = DATA / "fr079" / "log.carmen.gz"
BLOCK = 512


def note(benchmark, blocks):
    """Segments the blocks some times; the cheapest round goes into the JSON."""
    laser, config = LaserConfig(), SegmentationConfig()
    costs, found = [], []

    def once() -> None:
        start = time.process_time()
        found[:] = [len(segment_block(block, laser, config).scan) for block in blocks]
        costs.append(time.process_time() - start)

    benchmark.pedantic(once, rounds=15, warmup_rounds=2)
    many = sum(len(block) for block in blocks)
    benchmark.extra_info |= {
        "scans": many,
        "beams": blocks[0].laser.beams,
        "segments_per_scan": sum(found) / many,
        "microseconds_per_scan": 1e6 * min(costs) / many,
    }


def test_segmentation_of_a_room(benchmark):
    """One block of 360 beams, 1 cm of noise."""
    rng = np.random.default_rng(1)
    laser = HALF._replace(beams=360)
    poses = [
        (rng.uniform(0.5, 5.5), rng.uniform(1.8, 3.8), rng.uniform(-3.0, 3.0)) for _ in range(BLOCK)
    ]
    ranges = scans(ROOM, poses, laser)
    note(benchmark, [block(ranges + 0.01 * rng.standard_normal(ranges.shape), laser)])


@pytest.mark.skipif(not FR079.exists(), reason="no real logs here")
def test_segmentation_of_fr079(benchmark):
    """All scans of a real log."""
    note(benchmark, list(open_recording([FR079], InputConfig()).blocks(BLOCK)))
