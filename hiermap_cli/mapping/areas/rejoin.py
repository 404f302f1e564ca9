"""Areas of the filter that are one, out of the solution: one frame, one set, one covariance.

What several of them have seen of one wall is one wall of the solution already. The joined area is
therefore made as any other is, from all key scans of its parts: nothing is taken for independent
that is not, and no wall is there twice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR, AreaMap, Features, joined
from hiermap_cli.mapping.areas.joining import JoinedArea
from hiermap_cli.mapping.levels import change_frame
from hiermap_cli.mapping.refinement.rebuild import area_map, sightings
from hiermap_cli.mapping.refinement.refine import with_robot

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hiermap_cli.mapping.keyscans import KeyScans
    from hiermap_cli.mapping.refinement.refine import Refined


def joined_area(
    refined: Refined, parts: Sequence[int], keyscans: KeyScans, least: int
) -> JoinedArea:
    """One area of several of the filter's, in the frame of the door of the first.

    Args:
        refined: the solution, and the filter's areas out of it.
        parts: those that are one, the first entered first.
        keyscans: of the whole log.
        least: key scans that must have seen a wall or an end.
    """
    levels = refined.levels
    R_0_p = se2.between(levels.frames[parts[0]], levels.frames[list(parts)])
    if len(parts) == 1:
        area = refined.areas[parts[0]]
        one = AreaMap(levels.maps[parts[0]], area.features, area.next_uid)
        return JoinedArea(one, tuple(parts), np.zeros((1, 3)), (0,))
    first, whole, offset = refined.areas[parts[0]], None, []
    up = 0
    raised = np.zeros(len(refined.areas), dtype=np.int64)
    for p in parts:
        offset.append(up)
        raised[p] = up
        f = refined.areas[p].features
        anchors = Features._make(column[f.kind == ANCHOR] for column in f)
        anchors = anchors._replace(uid=anchors.uid + up)
        whole = anchors if whole is None else joined(whole, anchors)
        up += refined.areas[p].next_uid
    assert whole is not None
    of = keyscans.area
    s = keyscans.segments
    wall = np.where(s.wall >= 0, s.wall + raised[of[s.scan]], -1)
    keyscans = keyscans._replace(
        area=np.where(np.isin(of, parts), parts[0], -1), segments=s._replace(wall=wall)
    )
    solution = refined.solution
    seen = sightings(parts[0], keyscans, solution.state, refined.matched, up, least)
    map_ = area_map(
        AreaMap(first.V, whole, up),
        int(refined.frames[parts[0]]),
        int(refined.last[list(parts)].max()),
        seen,
        solution,
    )
    if refined.here in parts:
        frame = solution.state.poses[refined.frames[parts[0]]]
        map_ = with_robot(map_, frame, levels.robot, refined.beyond)
    V = change_frame(map_.V, levels.shifts[parts[0]])
    return JoinedArea(AreaMap(V, map_.features, map_.next_uid), tuple(parts), R_0_p, tuple(offset))
