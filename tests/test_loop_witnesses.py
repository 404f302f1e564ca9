"""Which loops are believed: no one on one witness, the surest first, the unlikely last."""

from __future__ import annotations

import numpy as np
import pytest

from hiermap_cli.config import Config
from hiermap_cli.geometry import se2
from hiermap_cli.mapping.loops.choice import judge
from hiermap_cli.mapping.loops.evidence import Evidence
from hiermap_cli.mapping.loops.found import Found
from hiermap_cli.mapping.loops.graph import Edges, joined, ways

LOOPS = Config().loops


def loops_of(net, pairs, shift, C):
    """Loops between fragments that ask for a shift of the later one in its own frame."""
    i, j = (np.array(column) for column in zip(*pairs, strict=True))
    R = se2.compose(
        se2.compose(net.frames[i], np.zeros(3)), se2.between(net.frames[i], net.frames[j])
    )
    R = se2.between(net.frames[i], se2.compose(np.array(shift), net.frames[j]))
    return Edges(i, j, R, np.repeat(C[None], len(i), axis=0))


@pytest.fixture
def long_way():
    """Sixty fragments there and back along a line: the ends know little of each other."""
    x = np.concatenate((np.arange(30) * 5.0, np.arange(30)[::-1] * 5.0))
    frames = np.column_stack((x, np.zeros(60), np.repeat([0.0, np.pi], 30)))
    C = np.repeat(np.diag([0.01, 0.01, 1e-4])[None], 59, axis=0)
    path = Edges(np.arange(59), np.arange(1, 60), se2.between(frames[:-1], frames[1:]), C)
    return ways(frames, path)


TIGHT = np.diag([0.003, 0.003, 1e-4])


def verdict_of(loops, net, leaps=None, **found):
    n = len(loops.i)
    leaps = np.zeros(len(net.frames), dtype=np.int64) if leaps is None else leaps

    def column(name, default):
        return np.array(found.get(name, [default] * n))

    evidence = Evidence(
        column("overlap", 10.0), column("cross", 3.0), column("walls", 5), column("pairs", 2),
        np.zeros((n, 3, 3)),
    )  # fmt: skip
    zero = np.zeros(n)
    found = Found(loops, evidence, column("second", 0.0), zero, column("crossing", 0.0))
    return judge(found, net, leaps, LOOPS)


def believed(verdict):
    none = np.zeros(len(verdict.sure), dtype=bool)
    return verdict.believed(none, none, LOOPS)


def test_no_loop_is_closed_on_one_witness(long_way):
    one = loops_of(long_way, [(2, 57)], (0.5, 0.3, 0.0), TIGHT)
    assert not believed(verdict_of(one, long_way)).any()


def test_a_second_witness_closes_both(long_way):
    two = loops_of(long_way, [(2, 57), (3, 56)], (0.5, 0.3, 0.0), TIGHT)
    verdict = verdict_of(two, long_way)
    assert believed(verdict).all()
    assert verdict.witnesses.tolist() == [1, 1]
    assert verdict.support.tolist() == [20.0, 20.0]


def test_a_loop_of_the_same_fragment_is_no_second_witness(long_way):
    two = loops_of(long_way, [(2, 57), (2, 56)], (0.5, 0.3, 0.0), TIGHT)
    assert not believed(verdict_of(two, long_way)).any()


def test_witnesses_that_ask_for_something_else_are_none(long_way):
    a = loops_of(long_way, [(2, 57)], (0.5, 0.3, 0.0), TIGHT)
    b = loops_of(long_way, [(3, 56)], (-1.5, 0.3, 0.0), TIGHT)
    verdict = verdict_of(joined((a, b)), long_way)
    assert not believed(verdict).any()
    assert verdict.rival.tolist() == [10.0, 10.0]


def test_two_corrections_with_as_much_to_say_wait_both(long_way):
    a = loops_of(long_way, [(2, 57), (3, 56)], (0.5, 0.3, 0.0), TIGHT)
    b = loops_of(long_way, [(2, 56), (3, 57)], (-1.5, 0.3, 0.0), TIGHT)
    both = joined((a, b))
    assert not believed(verdict_of(both, long_way)).any()
    verdict = verdict_of(both, long_way, overlap=[20.0, 20.0, 5.0, 5.0])
    assert believed(verdict).tolist() == [True, True, False, False]


def test_a_loop_with_a_second_place_about_as_good_waits(long_way):
    two = loops_of(long_way, [(2, 57), (3, 56)], (0.5, 0.3, 0.0), TIGHT)
    verdict = verdict_of(two, long_way, second=[0.9, 0.1])
    assert believed(verdict).tolist() == [False, True]


def test_loops_that_agree_on_something_unlikely_wait(long_way):
    sigma = np.sqrt(long_way.relative(np.array([2]), np.array([57]))[0, 0, 0])
    two = loops_of(long_way, [(2, 57), (3, 56)], (2.6 * sigma, 0.0, 0.0), TIGHT)
    assert not believed(verdict_of(two, long_way)).any()


def test_a_way_known_well_is_a_witness_itself(long_way):
    one = loops_of(long_way, [(28, 31)], (0.05, 0.0, 0.0), TIGHT)
    assert believed(verdict_of(one, long_way)).all()


def test_who_has_seen_through_walls_is_no_witness(long_way):
    two = loops_of(long_way, [(2, 57), (3, 56)], (0.5, 0.3, 0.0), TIGHT)
    verdict = verdict_of(two, long_way, crossing=[0.0, 0.15])
    assert verdict.witnesses.tolist() == [0, 0]
    assert not believed(verdict).any()


def test_what_is_unlikely_is_believed_last_and_only_of_loops_far_apart(long_way):
    sigma = np.sqrt(long_way.relative(np.array([2]), np.array([57]))[0, 0, 0])
    shift = (2.6 * sigma, 0.0, 0.0)
    unlikely = loops_of(long_way, [(2, 57), (5, 54)], shift, TIGHT)
    verdict = verdict_of(unlikely, long_way)
    assert not (verdict.sure | verdict.borne).any()
    assert verdict.last.all()
    assert believed(verdict).all()
    # While there is anything likelier left it waits.
    likely = loops_of(long_way, [(20, 39), (21, 38)], (0.1, 0.0, 0.0), TIGHT)
    verdict = verdict_of(joined((unlikely, likely)), long_way)
    assert believed(verdict).tolist() == [False, False, True, True]


def test_the_surest_loops_are_closed_first(long_way):
    far = loops_of(long_way, [(2, 57), (3, 56)], (0.3, 0.1, 0.0), TIGHT)
    near = loops_of(long_way, [(24, 35), (25, 34)], (0.1, 0.0, 0.0), TIGHT)
    verdict = verdict_of(joined((far, near)), long_way)
    assert verdict.borne[:2].all()
    assert believed(verdict).tolist() == [False, False, True, True]
    closed = np.array([False, False, True, True])
    assert verdict.believed(closed, np.zeros(4, dtype=bool), LOOPS).all()


def test_what_was_refused_is_not_believed_again(long_way):
    two = loops_of(long_way, [(2, 57), (3, 56)], (0.5, 0.3, 0.0), TIGHT)
    verdict = verdict_of(two, long_way)
    refused = np.array([True, True])
    assert not verdict.believed(~refused, refused, LOOPS).any()


def test_several_constellations_in_one_loop_need_no_witness_where_they_are_expected(long_way):
    strong = {"pairs": [5], "cross": [12.0], "overlap": [30.0]}
    one = loops_of(long_way, [(2, 57)], (0.5, 0.3, 0.0), TIGHT)
    assert believed(verdict_of(one, long_way, **strong)).all()
    assert not believed(verdict_of(one, long_way, **{**strong, "pairs": [2]})).any()
    assert not believed(verdict_of(one, long_way, **strong, second=[0.6])).any()
    sigma = np.sqrt(long_way.relative(np.array([2]), np.array([57]))[0, 0, 0])
    off = loops_of(long_way, [(2, 57)], (1.5 * sigma, 0.0, 0.0), TIGHT)
    assert not believed(verdict_of(off, long_way, **strong)).any()


def astray(net):
    """The ways when a step in the middle has lost the heading: the ends lie anywhere."""
    path = Edges(
        np.arange(59), np.arange(1, 60), se2.between(net.frames[:-1], net.frames[1:]),
        np.repeat(np.diag([0.01, 0.01, 1e-4])[None], 59, axis=0),
    )  # fmt: skip
    path.C_i_j[29] += np.diag([0.1, 0.1, 0.25])
    return ways(net.frames, path)


WIDE = [(2, 57), (4, 55), (6, 53), (8, 51), (10, 49)]


def test_where_the_gate_is_cut_off_many_far_apart_are_believed(long_way):
    net = astray(long_way)
    many = loops_of(net, WIDE, (0.3, 0.1, 0.0), TIGHT)
    verdict = verdict_of(many, net)
    assert verdict.sigma.min() > LOOPS.max_shift
    assert (verdict.witnesses >= 4).all()
    assert believed(verdict).any()
    few = loops_of(net, WIDE[:4], (0.3, 0.1, 0.0), TIGHT)
    assert not believed(verdict_of(few, net)).any()
    near = [(2, 57), (3, 56), (2, 55), (3, 57), (2, 56), (3, 55)]
    close_by = verdict_of(loops_of(net, near, (0.3, 0.1, 0.0), TIGHT), net)
    assert not believed(close_by).any()


def test_where_a_filter_has_leapt_the_gate_stays_cut_off(long_way):
    """It has found itself where it fits, and all it sees from there agrees, be it right or not."""
    net = astray(long_way)
    many = loops_of(net, WIDE, (0.3, 0.1, 0.0), TIGHT)
    leaps = (np.arange(60) >= 30).astype(np.int64)
    assert not believed(verdict_of(many, net, leaps)).any()


AHEAD, BEHIND = [(2, 57), (5, 54), (6, 53), (7, 52), (8, 51)], [(9, 50), (12, 47), (13, 46)]


def test_groups_that_only_the_path_between_them_parts_are_believed_last(long_way):
    """The path may be wrong; of loops of one fragment that disagree one must be."""
    far_ahead = loops_of(long_way, AHEAD, (0.1, 0.0, 0.0), TIGHT)
    behind = [*BEHIND, (14, 45), (15, 44), (16, 43)]
    far_behind = loops_of(long_way, behind, (2.1, 0.0, 0.0), TIGHT)
    verdict = verdict_of(joined((far_ahead, far_behind)), long_way)
    contradicted = verdict.rival >= LOOPS.second * verdict.support
    assert contradicted.any()
    assert not (verdict.sure | verdict.borne | verdict.last)[contradicted].any()
    assert verdict.against_path[contradicted].all()
    again = loops_of(long_way, behind, (-1.9, 0.0, 0.0), TIGHT)
    verdict = verdict_of(joined((far_behind, again)), long_way)
    assert not verdict.against_path.any()


def test_few_are_not_believed_against_the_path(long_way):
    a = loops_of(long_way, AHEAD[:2], (0.1, 0.0, 0.0), TIGHT)
    b = loops_of(long_way, BEHIND[:2], (2.1, 0.0, 0.0), TIGHT)
    verdict = verdict_of(joined((a, b)), long_way)
    contradicted = verdict.rival >= LOOPS.second * verdict.support
    assert contradicted.any()
    assert not verdict.against_path[contradicted].any()


def test_what_only_the_path_contradicts_comes_after_all_else(long_way):
    behind = [*BEHIND, (14, 45), (15, 44), (16, 43)]
    loops = joined((
        loops_of(long_way, AHEAD, (0.1, 0.0, 0.0), TIGHT),
        loops_of(long_way, behind, (2.1, 0.0, 0.0), TIGHT),
    ))  # fmt: skip
    verdict = verdict_of(loops, long_way)
    none = np.zeros(len(loops.i), dtype=bool)
    other = verdict._replace(last=np.arange(len(none)) == 0)
    assert other.believed(none, none, LOOPS).tolist() == other.last.tolist()
    assert verdict.believed(none, none, LOOPS).sum() > 1
