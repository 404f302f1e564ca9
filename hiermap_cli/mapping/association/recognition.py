"""Is the area in which the robot has come an area that it knows already (section 4 of figure 1)?

The anchors of the portals tell where every other area lies from here, the worse the longer the
way there. Where the robot stands in the free space of another area by that, the walls that it
has mapped here lately are laid on the walls of the other area, as `relocation` does with the
segments of one scan. They tell the place when at least four walls fit, not all parallel, and
no other place near by fits about as well; and it is believed when the same is found twice, with
some path in between.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.stochastic_map import relative_covariance
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.area_map import WALL
from hiermap_cli.mapping.association.relocation import area_lines, relocate
from hiermap_cli.mapping.portals import anchor_index
from hiermap_cli.perception.views import SegmentView

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import AreaConfig, Config
    from hiermap_cli.mapping.area_map import AreaMap
    from hiermap_cli.mapping.portals import Portal

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]


class Relative(NamedTuple):
    """Frames of other areas seen from here, or one of them.

    pose: R_c_h (..., 3). covariance: (..., 3, 3) of `log(R_c_h R_c_h_hat^-1)`, in this area's
    frame.
    """

    pose: Array
    covariance: Array

    def at(self, point: Array) -> Array:
        """Standard deviations (...) in metres of where a point (2,) of this area lies there."""
        (x, y), C = point.tolist(), self.covariance
        variance = C[..., 0, 0] + C[..., 1, 1] + 2.0 * (x * C[..., 1, 2] - y * C[..., 0, 2])
        sigma: Array = np.sqrt(np.maximum(variance + (x * x + y * y) * C[..., 2, 2], 0.0))
        return sigma


@dataclass(slots=True)
class Ways:
    """Ways through areas, from anchor to anchor; kept for as long as an area's map is the same."""

    _known: dict[int, tuple[AreaMap, dict[tuple[int, int], tuple[Array, Array]]]] = field(
        default_factory=dict
    )

    def between(self, number: int, area: AreaMap, i: int, j: int) -> tuple[Array, Array]:
        """Anchor j seen from anchor i by their uids (i = -1: from the frame), and its covariance.

        number: of the area.
        """
        if number not in self._known or self._known[number][0] is not area:
            self._known[number] = (area, {})
        known = self._known[number][1]
        if (i, j) not in known:
            k = -1 if i < 0 else anchor_index(area, i)
            known[i, j] = _between(area, k, anchor_index(area, j))
        return known[i, j]


def relative_frames(
    here: int, areas: Sequence[AreaMap], portals: Sequence[Portal], ways: Ways | None = None
) -> dict[int, Relative]:
    """Where the frames of all other areas lie, each by the way that tells it best.

    ways: what is known of earlier calls, and kept for later ones.
    """
    ways = ways or Ways()
    doors: dict[int, list[tuple[int, int, int]]] = {}
    for p in portals:
        doors.setdefault(p.a, []).append((p.anchor_a, p.b, p.anchor_b))
        doors.setdefault(p.b, []).append((p.anchor_b, p.a, p.anchor_a))
    found: dict[int, Relative] = {}
    # (cost, tie, area, anchor by which it is entered, that anchor seen from here)
    waiting: list[tuple[float, int, int, int, Relative]] = []
    ties = 0

    def leave(area: int, entered: int, at: Relative) -> None:
        nonlocal ties
        V = areas[area].V
        for out, there, into in doors.get(area, ()):
            if there in found or there == here:
                continue
            R, C = ways.between(area, areas[area], entered, out)
            Ad = se2.adjoint(at.pose)
            pose = se2.compose(at.pose, R)
            reached = Relative(pose, at.covariance + Ad @ C @ Ad.T)
            ties += 1
            heapq.heappush(waiting, (float(reached.at(V.robot[:2])), ties, there, into, reached))

    leave(here, -1, Relative(np.zeros(3), np.zeros((3, 3))))
    while waiting:
        _, _, area, anchor, at = heapq.heappop(waiting)
        if area in found:
            continue
        R, C = ways.between(area, areas[area], -1, anchor)
        frame = se2.compose(at.pose, se2.invert(R))
        Ad = se2.adjoint(frame)
        found[area] = Relative(frame, at.covariance + Ad @ C @ Ad.T)
        leave(area, anchor, at)
    return found


def _between(area: AreaMap, i: int, j: int) -> tuple[Array, Array]:
    """Pose j seen from pose i of an area (-1: from its frame), and its covariance there."""
    V = area.V
    if i >= 0:
        return se2.between(V.poses[i], V.poses[j]), relative_covariance(V, i, j)
    T, where = V.invariant_D_error(V.poses[j]), V.columns(j)
    return V.poses[j], T @ V.covariance[where, where] @ T.T


class Asked(NamedTuple):
    """An area that this may be. young: the robot has been in it ever since it began this one."""

    number: int
    area: AreaMap
    young: bool


class Recognised(NamedTuple):
    """An area in which the robot is: its index, and this area's frame seen from its, R_h_c."""

    area: int
    R_h_c: Array
    explained: float
    total: float
    walls: int


@dataclass(slots=True)
class Recogniser:
    """Asks now and then whether the robot is in another area than the one it maps."""

    config: Config
    frames: dict[int, Relative] = field(default_factory=dict)
    _ways: Ways = field(default_factory=Ways)
    _areas: list[int] = field(default_factory=list)
    _all: Relative = field(default_factory=lambda: Relative(np.zeros((0, 3)), np.zeros((0, 3, 3))))
    _asked: float = 0.0
    _before: dict[int, tuple[float, Recognised]] = field(default_factory=dict)

    def set(
        self, here: int, areas: Sequence[AreaMap], portals: Sequence[Portal], travelled: float
    ) -> None:
        """The robot is in this area from now on."""
        self.frames = relative_frames(here, areas, portals, self._ways)
        self._areas = sorted(self.frames)
        self._all = Relative(
            np.array([self.frames[h].pose for h in self._areas]).reshape(-1, 3),
            np.array([self.frames[h].covariance for h in self._areas]).reshape(-1, 3, 3),
        )
        self._asked = travelled
        self._before = {}

    def due(self, travelled: float) -> bool:
        """Whether there is reason to ask again: some path since the last time."""
        return travelled - self._asked >= self.config.areas.ask_every

    def asked(self, travelled: float) -> None:
        """Something was asked now."""
        self._asked = travelled

    def candidates(self, robot: Array) -> list[tuple[int, Array]]:
        """Areas whose place here is known well enough, with the robot's pose (3,) there."""
        if not self._areas:
            return []
        known = self._all.at(robot[:2]) < self.config.areas.ask_sigma
        poses = se2.between(self._all.pose[known], robot)
        return [
            (self._areas[i], R) for i, R in zip(known.nonzero()[0].tolist(), poses, strict=True)
        ]

    def ask(
        self, here: AreaMap, key: int, travelled: float, asked: Sequence[Asked]
    ) -> Recognised | None:
        """Which one of the areas asked for this is, if the same was found before."""
        self._asked = travelled
        if not asked:
            return None
        c = self.config.areas
        view, extent = lately_seen(here, key, c)
        if len(view.length) < c.least_walls - 1:
            return None
        answers = []
        for h, area, young in asked:
            found = self._match(h, area, view, extent)
            if found is None:
                self._before.pop(h, None)
            elif (young and self._as_predicted(found, here.V.robot)) or (
                found.walls >= c.least_walls and self._second(found, travelled, young, here)
            ):
                answers.append(found)
        return max(answers, key=lambda found: found.explained, default=None)

    def _as_predicted(self, found: Recognised, robot: Array) -> bool:
        """Whether the walls only say what the way here says as well: two witnesses in one."""
        frame = self.frames[found.area]
        predicted = se2.between(frame.pose, robot)
        off = se2.between(predicted, se2.compose(found.R_h_c, robot))
        known = float(frame.at(robot[:2])) < self.config.areas.sure_sigma
        return known and self._agree(off)

    def _second(self, found: Recognised, travelled: float, young: bool, here: AreaMap) -> bool:
        """Whether the same was found before, with path enough in between; else it is kept."""
        c, robot = self.config.areas, here.V.robot
        if found.area in self._before:
            first, before = self._before[found.area]
            at, was = se2.compose(found.R_h_c, robot), se2.compose(before.R_h_c, robot)
            if self._agree(se2.between(was, at)):
                return travelled - first >= (c.agree_path if young else c.agree_path_old)
        self._before[found.area] = (travelled, found)
        return False

    def _agree(self, off: Array) -> bool:
        c = self.config.areas
        return bool(np.hypot(off[0], off[1]) < c.agree and abs(off[2]) < c.agree_angle)

    def _match(self, h: int, area: AreaMap, view: SegmentView, extent: Array) -> Recognised | None:
        c = self.config
        frame = self.frames[h]
        R_h_c = se2.invert(frame.pose)
        Ad = se2.adjoint(R_h_c)
        found = relocate(
            _seen_from(area, R_h_c, Ad @ frame.covariance @ Ad.T, extent), view, c.relocation,
            suspect=False,
        )  # fmt: skip
        if found is None:
            return None
        R_h_c = se2.compose(found.pose, se2.invert(np.array([*extent, 0.0])))
        walls = walls_explained(area, view, found.pose, c)
        if walls < c.areas.least_walls - 1:
            return None
        return Recognised(h, R_h_c, found.explained, found.total, walls)


def lately_seen(area: AreaMap, key: int, config: AreaConfig) -> tuple[SegmentView, Array]:
    """Walls mapped in an area over the last key scans, as if they were segments of one scan.

    It is taken where the robot is, with the area's heading; returns that place (2,) too.
    """
    f = area.features
    walls = np.flatnonzero((f.kind == WALL) & (f.last >= key - config.recent) & (f.seen >= 2))
    X = area.V.poses[1 + walls]
    lo, hi = f.lo[walls], f.hi[walls]
    direction = np.column_stack((np.cos(X[:, 2]), np.sin(X[:, 2])))
    middle: Array = area.V.robot[:2].copy()
    centre = X[:, :2] + (0.5 * (lo + hi))[:, None] * direction - middle
    half = (0.5 * (hi - lo))[:, None] * direction
    n = len(walls)
    view = SegmentView(
        centre, X[:, 2], np.zeros(n), np.zeros(n), np.stack((centre - half, centre + half), axis=1),
        np.zeros((n, 2), dtype=np.int64), np.zeros((n, 2)), hi - lo,
    )  # fmt: skip
    return view, middle


def _seen_from(area: AreaMap, R_h_c: Array, C: Array, middle: Array) -> AreaMap:
    """The area with its robot where a robot at `middle` of the other area would be.

    C is the covariance of `log(R_h_c R_h_c_hat^-1)`. The sensor's offset is none.
    """
    V = area.V
    pose = se2.compose(R_h_c, np.array([*middle, 0.0]))
    poses, P = V.poses.copy(), V.covariance.copy()
    poses[0] = pose
    T = se2.additive_D_invariant(pose) if V.coordinates == "additive" else np.eye(3)
    P[:3], P[:, :3] = 0.0, 0.0
    P[:3, :3] = T @ C @ T.T
    return area._replace(
        V=V._replace(poses=poses, covariance=P, parameters=np.zeros_like(V.parameters))
    )


def walls_explained(area: AreaMap, view: SegmentView, pose: Array, config: Config) -> int:
    """How many walls of the view lie on walls of the area at this pose; 0 if all are parallel."""
    lines = area_lines(area, config.relocation.least_seen)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    ends = pose[:2] + view.ends @ np.array([[c, s], [-s, c]])
    across = np.abs(ends @ lines.normal.T - lines.offset).max(axis=1)
    direction = np.column_stack((lines.normal[:, 1], -lines.normal[:, 0]))
    along = ends @ direction.T
    overlap = np.minimum(along.max(axis=1), lines.hi) - np.maximum(along.min(axis=1), lines.lo)
    angle = np.abs(se2.wrap(view.theta[:, None] + pose[2] - lines.theta))
    r = config.relocation
    fits = (across < r.max_offset) & (angle < r.max_angle) & (overlap > 0.3 * view.length[:, None])
    explained = np.flatnonzero(fits.any(axis=1))
    theta = view.theta[explained]
    if len(theta) < 2 or np.abs(np.sin(theta[:, None] - theta)).max() < 0.5:
        return 0
    return len(explained)
