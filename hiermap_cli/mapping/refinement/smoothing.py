"""Gauss-Newton over the whole log: assembled by stretches of the path, solved by fronts."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hiermap_cli.estimation.fronts import Factor, Piece, Plan, factorise, plan
from hiermap_cli.estimation.motion import PARAMETERS, prior_covariance
from hiermap_cli.mapping.refinement.problem import (
    Layout,
    Terms,
    end_terms,
    layout,
    odometry_terms,
    stepped,
    wall_terms,
)
from hiermap_cli.mapping.refinement.unevenness import with_common

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hiermap_cli.config import Config
    from hiermap_cli.mapping.keyscans import KeyScans
    from hiermap_cli.mapping.refinement.problem import Matched, Noise, State

    Array = NDArray[np.float64]
    Index = NDArray[np.int64]

STRETCH = 24  # key scans eliminated together
FIXED = 1e-6  # metres and radians: the first pose is g
KNOWN = 1e-12  # variance of a parameter whose prior is 0


class Structure(NamedTuple):
    """Which variables every stretch has, and in which order they are eliminated.

    first: (R + 1,) key scans that part the stretches. columns: the variables of each, sorted.
    """

    first: Index
    columns: tuple[Index, ...]
    plan: Plan


class Solution(NamedTuple):
    """A state, the factor of its normal equations, and the last residuals."""

    state: State
    structure: Structure
    factor: Factor
    terms: tuple[Terms, Terms, Terms]  # odometry, walls, ends


def structure(where: Layout, terms: Sequence[Terms]) -> Structure:
    """Stretches of the path, and an order of elimination for what they share.

    The poses within a stretch are eliminated first, each stretch by itself; landmarks are
    grouped by the first and last stretch that shows them.
    """
    first = np.arange(0, where.keys, STRETCH)
    first = np.append(first[: max(1, len(first))], where.keys)
    stretches = len(first) - 1
    rows = [(stretch_of(t.scan), t.columns) for t in terms]
    landmark_first = np.full(where.size, stretches)
    landmark_last = np.full(where.size, -1)
    for r, index in rows:
        every = np.broadcast_to(r[:, None], index.shape)
        np.minimum.at(landmark_first, index, every)
        np.maximum.at(landmark_last, index, every)
    columns = []
    shown = [_by_stretch(r, index, stretches) for r, index in rows]
    parameters = where.parameters + np.arange(PARAMETERS)
    for k in range(stretches):
        # The pose that begins the next stretch belongs to both.
        poses = np.arange(3 * first[k], 3 * min(first[k + 1] + 1, where.keys))
        seen = np.concatenate([index[a[k] : a[k + 1]].ravel() for index, a in shown] or [poses])
        seen = seen[seen >= where.parameters]
        columns.append(np.unique(np.concatenate((poses, parameters, seen))))
    groups = [np.arange(3 * (a + 1), 3 * b) for a, b in itertools.pairwise(first)]
    groups += [np.arange(3 * a, 3 * a + 3) for a in first[:-1]]
    landmarks = np.arange(where.parameters + PARAMETERS, where.size)
    pair = landmark_first[landmarks] * (stretches + 1) + landmark_last[landmarks]
    order = np.argsort(pair, kind="stable")
    cuts = np.flatnonzero(np.diff(pair[order])) + 1
    groups += [g for g in np.split(landmarks[order], cuts) if len(g)]
    groups.append(parameters)
    groups = [g for g in groups if len(g)]
    return Structure(first, tuple(columns), plan(columns, groups, [len(groups) - 1]))


def _by_stretch(stretch: Index, columns: Index, stretches: int) -> tuple[Index, Index]:
    """Rows of columns (n, k) in the order of their stretches, and where each stretch begins."""
    order = np.argsort(stretch, kind="stable")
    return columns[order], np.searchsorted(stretch[order], np.arange(stretches + 1))


def stretch_of(scan: Index) -> Index:
    """The stretch of each key scan."""
    return scan // STRETCH


def assemble(
    where: Layout, frame: Structure, terms: Sequence[Terms], state: State, config: Config
) -> list[Piece]:
    """The normal equations of every stretch, and the priors."""
    contributions = []
    for t in terms:
        JW = t.J.transpose(0, 2, 1) @ t.information
        H = JW @ t.J
        g = -(JW @ t.e[:, :, None])[:, :, 0]
        r = stretch_of(t.scan)
        bounds = np.searchsorted(r, np.arange(len(frame.columns) + 1))
        contributions.append((t.columns, H, g, bounds))
    lookup = np.empty(where.size, dtype=np.int64)
    pieces = []
    for k, index in enumerate(frame.columns):
        n = len(index)
        lookup[index] = np.arange(n)
        H, g = np.zeros(n * n), np.zeros(n)
        for variables, of_H, of_g, bounds in contributions:
            part = slice(bounds[k], bounds[k + 1])
            at = lookup[variables[part]]
            flat = (n * at[:, :, None] + at[:, None, :]).ravel()
            H += np.bincount(flat, of_H[part].ravel(), n * n)
            g += np.bincount(at.ravel(), of_g[part].ravel(), n)
        pieces.append(Piece(index, H.reshape(n, n), g))
    # A prior of 0 is a parameter that is known; an infinite information could not be solved.
    information = 1.0 / np.maximum(np.diag(prior_covariance(config.odometry)), KNOWN)
    first = pieces[0]
    at = np.searchsorted(first.columns, np.arange(3))
    first.H[at, at] += 1.0 / FIXED**2
    at = np.searchsorted(first.columns, where.parameters + np.arange(PARAMETERS))
    first.H[at, at] += information
    first.g[at] -= information * state.parameters
    return pieces


def smooth(
    state: State,
    keyscans: KeyScans,
    noise: Noise,
    matched: Matched,
    config: Config,
    factor: float,
    *,
    last: bool,
) -> Solution:
    """Gauss-Newton from a state, with these matches.

    factor: on the odometry's variances. last: the factor is wanted at the state returned.

    Raises:
        numpy.linalg.LinAlgError: the log does not determine the problem.
    """
    where = layout(state)
    frame: Structure | None = None
    converged = False
    for n in range(config.refine.steps + 1):
        final = converged or n == config.refine.steps
        if final and not last:
            break
        terms = _terms(state, keyscans, noise, matched, config, factor)
        frame = frame or structure(where, terms)
        given = _believed(terms, state, keyscans, noise, matched, config) if final else terms
        solved = factorise(assemble(where, frame, given, state, config), frame.plan, where.size)
        if final:
            break
        x = solved.solve()
        x[:3] = 0.0  # g is where the first pose is: nothing but rounding moves it
        state = stepped(state, x)
        converged = np.abs(x[: where.parameters]).max(initial=0.0) < config.refine.converged
    assert frame is not None
    return Solution(state, frame, solved, terms)


def _believed(
    terms: tuple[Terms, Terms, Terms],
    state: State,
    keyscans: KeyScans,
    noise: Noise,
    matched: Matched,
    config: Config,
) -> tuple[Terms, Terms, Terms]:
    """The terms as they bear on the covariance: with what sights of one piece have in common."""
    odometry, walls, ends = terms
    s, gate = keyscans.segments, config.refine.gate_wall
    return odometry, with_common(walls, state, s, noise, matched, gate), ends


def _terms(
    state: State,
    keyscans: KeyScans,
    noise: Noise,
    matched: Matched,
    config: Config,
    factor: float,
) -> tuple[Terms, Terms, Terms]:
    c, s = config.refine, keyscans.segments
    return (
        odometry_terms(state, keyscans, config.odometry, factor, c.gate_odometry),
        wall_terms(state, s, noise, matched, c.gate_wall),
        end_terms(state, s, noise, matched, c.gate_end, c.end_bias),
    )
