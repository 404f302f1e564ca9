"""Walls that are no lines: what all sights of a piece have in common, and what is believed then."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from world_cases import DATASETS

from hiermap_cli.config import Config
from hiermap_cli.evaluation.consistency import robot_nees
from hiermap_cli.mapping.keyscans import ScanSegments
from hiermap_cli.mapping.refinement.problem import Ends, Matched, Noise, State, Walls, wall_terms
from hiermap_cli.mapping.refinement.unevenness import (
    VISIT,
    Pieces,
    common_share,
    pieces,
    together,
    with_common,
)
from hiermap_cli.mapping.run import map_log
from hiermap_cli.simulation.simulator import simulate
from hiermap_cli.simulation.world import build_world, load_world

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SIGMA = 0.02
GATE = 9.2


def sights(share: float, seed: int, walls: int = 12, parts: int = 8, each: int = 15) -> Any:
    """A robot that passes walls of 8 m, y = 0 of their own frames, metre by metre.

    Whatever is common to a metre has `share` of SIGMA's variance beside that of each sight.
    Returns the state, the segments and what they were matched with.
    """
    rng = np.random.default_rng(seed)
    n = walls * parts * each
    wall = np.repeat(np.arange(walls), parts * each)
    part = np.tile(np.repeat(np.arange(parts), each), walls)
    off = rng.normal(0.0, SIGMA, n)
    off += np.sqrt(share) * SIGMA * rng.normal(size=(walls, parts))[wall, part]
    for w in range(walls):  # a wall lies where its sights have put it
        own = wall == w
        off[own] -= np.polyval(np.polyfit(part[own], off[own], 1), part[own])
    along = part + rng.uniform(0.05, 0.95, n)
    scan = np.arange(n)
    segments = ScanSegments(
        scan=scan,
        centre=np.column_stack((along, off)),
        theta=rng.normal(0.0, 0.01, n),
        var_theta=np.full(n, 1e-4),
        var_y=np.full(n, SIGMA**2),
        ends=np.zeros((n, 2, 2)),
        end_kind=np.zeros((n, 2), dtype=np.int64),
        end_sigma=np.full((n, 2), 0.01),
        length=np.full(n, 0.8),
        wall=wall,
    )
    none = np.zeros(0, dtype=np.int64)
    state = State(
        np.zeros((n, 3)),
        np.zeros(4),
        Walls(np.zeros((walls, 3)), np.zeros(walls), np.full(walls, 8.0)),
        Ends(none, none, np.zeros(0)),
    )
    return state, segments, Matched(scan, wall, none, none, none)


def terms_of(state: State, segments: ScanSegments, matched: Matched) -> Any:
    n = len(matched.segment)
    noise = Noise(np.full(n, SIGMA**2), np.full(n, 1e-4), np.full((n, 2), 1e-4))
    return wall_terms(state, segments, noise, matched, GATE), noise


def test_sights_of_one_metre_are_of_one_piece():
    state, segments, matched = sights(0.0, 0)
    parts = pieces(state, segments, matched)
    metre = 8 * matched.wall + np.floor(segments.centre[:, 0]).astype(np.int64)
    assert len(parts.wall) == 96
    assert (np.diff(parts.shown[np.argsort(metre, kind="stable")]) >= 0).all()
    assert np.array_equal(parts.wall[parts.shown], matched.wall)


def test_longer_segments_are_of_longer_pieces():
    state, segments, matched = sights(0.0, 0)
    length = np.full(len(segments.scan), 3.0)
    parts = pieces(state, segments._replace(length=length), matched)
    assert len(parts.wall) == 24  # of four metres each
    mixed = np.where(np.arange(len(length)) % 2, 3.0, 0.8)
    assert len(pieces(state, segments._replace(length=mixed), matched).wall) == 24 + 96


@pytest.mark.parametrize("seed", range(5))
def test_independent_errors_have_nothing_in_common(seed):
    state, segments, matched = sights(0.0, seed)
    z = segments.centre[:, 1] / SIGMA
    parts = pieces(state, segments, matched)
    assert common_share(z, np.ones(len(z), dtype=bool), parts) < 0.01


@pytest.mark.parametrize("share", [0.2, 1.0])
def test_a_common_part_is_found_out_in_the_mean(share):
    found = []
    for seed in range(8):
        state, segments, matched = sights(share, seed)
        z = segments.centre[:, 1] / SIGMA
        parts = pieces(state, segments, matched)
        found.append(common_share(z, np.ones(len(z), dtype=bool), parts))
    # Two standard errors are taken off: of 96 pieces a share of 0.1 to 0.3 of itself.
    assert 0.5 * share < np.mean(found) < share


def test_too_few_pieces_tell_nothing():
    state, segments, matched = sights(1.0, 0, walls=6, parts=2)
    z = segments.centre[:, 1] / SIGMA
    parts = pieces(state, segments, matched)
    assert common_share(z, np.ones(len(z), dtype=bool), parts) == 0.0


def test_a_visit_ends_where_the_piece_is_not_seen_for_long():
    parts = Pieces(np.array([0, 1, 0, 0, 1, 0]), np.array([0, 0]))
    scan = np.array([5, 5, 6, 7 + VISIT, 8, 6 + VISIT])
    # Piece 0 at 5, 6, then 6 + VISIT: no longer than a visit allows.
    assert together(parts, scan).tolist() == [4, 2, 4, 4, 2, 4]
    scan[[3, 5]] += 1
    assert together(parts, scan).tolist() == [2, 2, 2, 2, 2, 2]


def test_the_solution_keeps_its_weights_and_the_covariance_gets_the_common_part():
    state, segments, matched = sights(1.0, 3)
    walls, noise = terms_of(state, segments, matched)
    believed = with_common(walls, state, segments, noise, matched, GATE)
    factor = believed.information[:, 0, 0] / walls.information[:, 0, 0]
    # Fifteen sights of each piece, of which 1 / (1 + 15 share) is left.
    assert np.allclose(factor, factor[0])
    assert 1.0 / 16.0 < factor[0] < 1.0 / 8.0
    assert np.array_equal(believed.information[:, 1, 1], walls.information[:, 1, 1])
    assert np.array_equal(believed.e, walls.e)


def test_without_sights_nothing_is_changed():
    state, segments, matched = sights(1.0, 3)
    nothing = matched._replace(segment=matched.segment[:0], wall=matched.wall[:0])
    walls, noise = terms_of(state, segments, nothing)
    assert with_common(walls, state, segments, noise, nothing, GATE) is walls


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def slabs(world: dict[str, Any], deep: float, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Boxes of 1 to 3 m along all walls, up to so many metres deep, none near a door."""
    doors = [(np.array(door["at"]), 0.5 * door["width"] + 0.25) for door in world["doors"]]
    boxes = []
    for area in world["areas"]:
        corners = np.array(area.get("polygon") or box(*area["box"]))
        for a, b in pairwise((*corners, corners[0])):
            length = float(np.hypot(*(b - a)))
            way = (b - a) / length
            into, begin = np.array([-way[1], way[0]]), 0.0
            while begin < length - 0.1:
                end = min(begin + rng.uniform(1.0, 3.0), length)
                thick = 0.5 * world["wall_thickness"] + rng.uniform(0.01, deep)
                two = np.array([a + begin * way, a + end * way + thick * into])
                low, high = two.min(axis=0), two.max(axis=0)
                if not any(((at > low - r) & (at < high + r)).all() for at, r in doors):
                    boxes.append({"box": [*low.tolist(), *high.tolist()]})
                begin = end
    return boxes


@pytest.mark.slow
def test_an_uneven_building_is_not_believed_to_be_known_better_than_it_is():
    """Walls of the office in steps of up to 4 cm: 2.3 without a common part, 0.65 with it."""
    spec = load_world(DATASETS / "office.yaml").spec
    nees = []
    for seed in range(3):
        world = spec.model_dump(exclude_none=True)
        world["walls"] = [*world.get("walls", []), *slabs(world, 0.04, np.random.default_rng(seed))]
        built = build_world(type(spec).model_validate(world))
        simulation = simulate(built, np.random.default_rng(seed))
        result = map_log(simulation.blocks(), Config())
        nees.append(robot_nees(result.trajectory, simulation.stamps_ns, simulation.truth).mean)
    assert 0.3 < np.mean(nees) < 1.5
