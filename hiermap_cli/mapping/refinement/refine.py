"""The whole log again: loops, then poses, walls, ends and calibration solved together.

With the topology settled by the filter, its matches begin the walls; the poses are solved with
them, what then lies on one line becomes one wall, and so on from coarse to fine. The filter's
areas are then seen anew in the solution.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.gaussian import symmetrise
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import ANCHOR
from hiermap_cli.mapping.levels import Levels, change_frame, door_frames
from hiermap_cli.mapping.loops.closing import LoopResult, close_loops
from hiermap_cli.mapping.refinement.matches import (
    all_matches,
    filter_labels,
    fit_walls,
    match_segments,
    merge_walls,
    placed,
)
from hiermap_cli.mapping.refinement.problem import (
    Ends,
    State,
    Walls,
    layout,
    measured_noise,
    segment_noise,
)
from hiermap_cli.mapping.refinement.rebuild import area_map, sightings
from hiermap_cli.mapping.refinement.smoothing import smooth
from hiermap_cli.mapping.refinement.track import whole_trajectory
from hiermap_cli.mapping.topology.seen_anew import seen_from

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.keyscans import KeyScans
    from hiermap_cli.mapping.mapper import Mapper
    from hiermap_cli.mapping.refinement.problem import Matched, Noise
    from hiermap_cli.mapping.refinement.smoothing import Solution
    from hiermap_cli.mapping.topology.places import Places

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Refined(NamedTuple):
    """The filter's areas and levels, out of the solution of the whole log.

    frames, last: (K,) key scans at which each area's frame lies, and at which the robot was last
    in it. places: the free space of all areas in their frames, seen from the solution's poses.
    here, beyond: the area in which the robot is in the end, and the covariance (3, 3) of what
    odometry adds to its invariant error in g after the last key scan.
    """

    areas: list[AreaMap]
    levels: Levels
    solution: Solution
    matched: Matched
    loops: LoopResult
    frames: Index
    last: Index
    places: Places
    here: int
    beyond: Array


def refine(mapper: Mapper, levels: Levels) -> Refined:
    """Goes over the log again, from what the filter made of it.

    Raises:
        numpy.linalg.LinAlgError: the log does not determine the problem.
    """
    config, keyscans = mapper.config, mapper.keyscans.taken()
    parameters = mapper.area.V.parameters.copy()
    poses = levels.trajectory.poses[np.array(mapper.trail.key_at)]
    start = np.array(config.start_pose)
    loops = close_loops(keyscans, poses, config, mapper.noise)
    poses = se2.compose(start, se2.between(loops.poses[0], loops.poses))
    nothing = np.zeros(0, dtype=np.int64)
    state = State(
        poses,
        parameters,
        Walls(np.zeros((0, 3)), np.zeros(0), np.zeros(0)),
        Ends(nothing, nothing, np.zeros(0)),
    )
    noise = segment_noise(keyscans.segments, config.filter, mapper.noise)
    solution, matched = solve(state, keyscans, noise, mapper.noise.odometry, config)
    frames = _frame_keys(mapper)
    last = frames.copy()
    np.maximum.at(last, keyscans.area, np.arange(len(keyscans.area)))
    areas, refined, beyond = _seen_anew(mapper, keyscans, solution, matched, frames, last)
    looks = mapper.crossings.places.looks
    assert looks is not None
    poses = solution.state.poses
    places = seen_from(looks.taken(), poses, poses[frames], config.doors.max_width)
    return Refined(
        areas, refined, solution, matched, loops, frames, last, places, mapper.current, beyond
    )


def solve(
    state: State, keyscans: KeyScans, noise: Noise, odometry: float, config: Config
) -> tuple[Solution, Matched]:
    """Walls out of the filter's matches, merged and solved for from coarse to fine."""
    c, s = config.refine, keyscans.segments
    tracks = filter_labels(keyscans)
    n = int(tracks.max(initial=-1)) + 1
    for k, scale in enumerate(c.scales):
        where = placed(state, s)
        one = merge_walls(fit_walls(where, tracks, s.length, n), scale, c)
        labels = np.append(one, -1)[tracks]  # -1, of no track, takes the last
        count = int(one.max(initial=-1)) + 1
        walls = fit_walls(where, labels, s.length, count)
        labels = match_segments(walls, where, s, scale, c)
        state = state._replace(walls=fit_walls(where, labels, s.length, count))
        state, matched = all_matches(state, labels, s, noise, c)
        last = k + 1 == len(c.scales)
        solution = smooth(state, keyscans, noise, matched, config, odometry, last=last)
        state = solution.state
        if config.noise.estimate:
            noise = measured_noise(noise, solution.terms, layout(state).size, c.gate_wall)
    return solution, matched


def _seen_anew(
    mapper: Mapper,
    keyscans: KeyScans,
    solution: Solution,
    matched: Matched,
    frames: Index,
    last: Index,
) -> tuple[list[AreaMap], Levels, Array]:
    state, where = solution.state, layout(solution.state)
    least = mapper.config.landmarks.least_seen
    areas = [
        area_map(
            area,
            int(frames[i]),
            int(last[i]),
            sightings(i, keyscans, state, matched, area.next_uid, least),
            solution,
        )
        for i, area in enumerate(mapper.areas)
    ]
    shifts = door_frames(len(areas), mapper.portals)
    end = len(keyscans.area) - 1
    keys = np.concatenate(([end], frames))
    J = np.zeros((3 * len(keys), 3 * len(keys)))
    for i, block in enumerate(se2.adjoint(state.poses[keys])):
        J[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = block
    C = solution.factor.covariance(J, where.pose(keys).ravel())
    trajectory, robot, extra = whole_trajectory(mapper, solution)
    C[:3, :3] += extra
    here = mapper.current
    areas[here] = with_robot(areas[here], state.poses[frames[here]], robot, extra)
    refined = Levels(
        maps=tuple(change_frame(area.V, shifts[i]) for i, area in enumerate(areas)),
        frames=se2.compose(state.poses[frames], shifts),
        covariance=C,
        robot=robot,
        shifts=shifts,
        trajectory=trajectory,
    )
    return areas, refined, extra


def with_robot(area: AreaMap, frame: Array, robot: Array, extra: Array) -> AreaMap:
    """The area with the robot where the log ends, after the last key scan.

    frame, robot: (3,) in g. extra: (3, 3) what odometry adds to the robot's invariant error in g.
    """
    V = area.V
    poses, C = V.poses.copy(), V.covariance.copy()
    poses[0] = se2.between(frame, robot)
    # Its own error at the key scan stays the same in g, and so in the area.
    before = V.invariant_D_error(V.poses[0])
    after = V.error_D_tangent(poses[0]) @ se2.adjoint(se2.invert(poses[0]))
    C[:3] = after @ before @ C[:3]
    C[:, :3] = C[:, :3] @ (after @ before).T
    Ad = after @ se2.adjoint(se2.invert(frame))
    C[:3, :3] += Ad @ extra @ Ad.T
    return area._replace(V=V._replace(poses=poses, covariance=symmetrise(C)))


def _frame_keys(mapper: Mapper) -> Index:
    """The key scan at which each area's frame lies: where the robot was when it began it."""
    keys = np.zeros(len(mapper.areas), dtype=np.int64)
    entered = {0}
    for portal in mapper.portals:
        if portal.b not in entered:
            entered.add(portal.b)
            f = mapper.areas[portal.b].features
            keys[portal.b] = f.last[(f.kind == ANCHOR) & (f.uid == portal.anchor_b)][0]
    return keys
