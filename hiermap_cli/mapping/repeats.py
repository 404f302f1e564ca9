"""Scans that a log holds twice: they tell the estimator nothing, and have their lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.mapping.model import Trajectory

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from hiermap_cli.logs.records import ScanBlock


class Repeats:
    """Takes repeated scans out of a log's blocks, and puts their poses into its trajectory."""

    def __init__(self) -> None:
        # Of each scan that was left out, the row of the scan that it repeats; none in most logs.
        self._rows: list[int] = []
        self._kept = 0

    def left_out(self, blocks: Iterable[ScanBlock]) -> Iterator[ScanBlock]:
        """The blocks without repeated scans, as they are where there are none."""
        for block in blocks:
            if block.repeated is None or not block.repeated.any():
                self._kept += len(block)
                yield block
                continue
            new = ~block.repeated
            rows = self._kept + np.cumsum(new) - 1
            self._rows += rows[block.repeated].tolist()
            self._kept += int(new.sum())
            if new.any():
                yield block.part(np.flatnonzero(new))

    def restored(self, trajectory: Trajectory) -> Trajectory:
        """The trajectory with a line for every scan: a repeated one is where its original is."""
        if not self._rows:
            return trajectory
        times = np.ones(self._kept, dtype=np.int64)
        np.add.at(times, self._rows, 1)
        rows = np.repeat(np.arange(self._kept), times)
        return Trajectory(
            trajectory.stamps_ns[rows], trajectory.poses[rows], trajectory.covariances[rows]
        )
