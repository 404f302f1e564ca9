"""Reading of true relations: `t1 t2 x y z roll pitch yaw`, the pose at t2 seen from that at t1.

The format of Kuemmerle et al. 2009, "On measuring the accuracy of SLAM algorithms".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.documents.tum import TUM_COLUMNS, looks_like_poses, read_number_lines
from hiermap_cli.errors import InputError
from hiermap_cli.geometry.se2 import wrap

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

RELATION_COLUMNS = "t1 t2 x y z roll pitch yaw"


class Relations(NamedTuple):
    """M true relations: stamps (M,) int64 in the log's time, `R_1_2` as poses (M, 3)."""

    stamps1_ns: NDArray[np.int64]
    stamps2_ns: NDArray[np.int64]
    poses: NDArray[np.float64]

    def select(self, chosen: NDArray[np.bool_]) -> Relations:
        """The relations where `chosen` (M,) is True."""
        return Relations(self.stamps1_ns[chosen], self.stamps2_ns[chosen], self.poses[chosen])


def read_relations(path: Path) -> Relations:
    """The relations of a file; lines that begin with # are comments.

    Raises:
        InputError: the file cannot be read, holds no relation or a trajectory, or a line is not
            eight finite numbers; the message names file and line.
    """
    table = read_number_lines(path, 8, RELATION_COLUMNS, stamp_columns=2)
    if looks_like_poses(table):
        raise InputError(
            f"{path}: holds a trajectory ({TUM_COLUMNS}), no relations ({RELATION_COLUMNS}): its "
            "second column is no stamp"
        )
    poses = np.column_stack((table.values[:, 2], table.values[:, 3], wrap(table.values[:, 7])))
    return Relations(table.stamps_ns[:, 0], table.stamps_ns[:, 1], poses)
