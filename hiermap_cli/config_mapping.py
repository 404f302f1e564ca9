"""The configuration of the map: what is known again, what is a door, an area, a landmark."""

from __future__ import annotations

from pydantic import Field

from hiermap_cli.config_fields import NonNegative, Positive, Section


class OdometryFaultConfig(Section):
    """When odometry is taken to lie."""

    turning_speed: Positive = Field(0.15, description="m/s, below which a robot may turn about")
    poor_share: NonNegative = Field(0.6, le=1, description="of a scan's segments; fewer match ill")
    poor_nis: Positive = Field(2.5, description="a row of a scan; a larger one matches ill")
    sound_share: NonNegative = Field(
        0.75, le=1, description="of a scan's segments; where more match, the walls are known here"
    )
    clear: Positive = Field(15.0, description="of chi-square, for one hypothesis to be the truth")
    shown: Positive = Field(
        25.0, description="of chi-square that would have shown if odometry had the wrong sign"
    )
    share: NonNegative = Field(0.1, description="of what fits ill at best, more to be clear")
    min_path: Positive = Field(0.15, description="metres of path that can tell the direction")
    backward: Positive = Field(
        0.1, description="metres told of backing up; such odometry has hardly lost its sign"
    )
    signed: Positive = Field(
        0.5, description="metres told of backing up; such odometry is believed when it tells ahead"
    )
    max_backward: Positive = Field(
        1.0, description="metres that a robot backs up where nothing confirms it"
    )
    max_path: Positive = Field(4.0, description="metres after which a turning point is forgotten")
    max_keys: int = Field(30, ge=1, description="key scans after which it is forgotten")
    missing_change: Positive = Field(
        0.1, description="metres that a range changes where the robot does not stand"
    )
    missing_share: Positive = Field(
        0.2, le=1, description="of the ranges that change where odometry is missing"
    )


class LostConfig(Section):
    """When the robot is not where it is believed to be, and how it is found anywhere."""

    scans: int = Field(4, ge=1, description="key scans in a row that fit nothing")
    others: Positive = Field(
        0.18, le=1, description="of the ranges; more are others where a robot has been put down"
    )
    other_range: Positive = Field(0.1, description="metres by which a range is another")
    behind: Positive = Field(0.5, description="metres behind a wall that a beam cannot reach")
    seen_through: Positive = Field(
        0.25, le=1, description="of the beams; more go through walls where the robot is not"
    )
    sigma: Positive = Field(5.0, description="metres, where a lost robot may be")
    sigma_angle: Positive = Field(2.0, description="radians, how a lost robot may face")
    min_share: Positive = Field(0.6, le=1, description="of the walls' length explained")
    min_explained: Positive = Field(4.0, description="metres of walls explained")
    min_seen: Positive = Field(0.5, le=1, description="of the ends of beams that were seen before")
    max_against: Positive = Field(0.08, le=1, description="of what was seen, against the place")
    floor: Positive = Field(0.02, le=1, description="of what was seen, against any place")
    clear: Positive = Field(2.5, ge=1, description="as much against every other place")


class RelocationConfig(Section):
    """Finding the robot again when the prediction cannot be trusted."""

    max_speed: Positive = Field(2.0, description="m/s; faster odometry has failed")
    max_turn_rate: Positive = Field(2.2, description="rad/s; faster odometry has failed")
    poor_match: NonNegative = Field(0.45, le=1, description="share of the segments' length")
    max_distance: Positive = Field(1.5, description="metres searched about the prediction")
    max_turn: Positive = Field(1.7, description="radians searched about the prediction")
    window_sigmas: Positive = Field(4.0, description="searched where odometry is not suspect")
    min_distance: Positive = Field(0.3, description="metres searched at least")
    min_turn: Positive = Field(0.25, description="radians searched at least")
    least_seen: int = Field(3, ge=1, description="sightings of a wall that may tell the place")
    min_length: Positive = Field(0.3, description="metres; segments that hypotheses are made of")
    max_angle: Positive = Field(0.07, description="radians between a segment and its wall")
    max_offset: Positive = Field(0.12, description="metres between a segment and its wall")
    min_share: Positive = Field(0.4, le=1, description="share of the segments' length explained")
    gain: NonNegative = Field(0.15, le=1, description="share matched more than before")
    min_gain: NonNegative = Field(0.8, description="metres matched more than before")
    min_explained: Positive = Field(2.0, description="metres of segments explained")
    second: Positive = Field(0.85, le=1, description="the second best, of the best")
    distinct: Positive = Field(0.3, description="metres between different places")
    distinct_angle: Positive = Field(0.15, description="radians between different places")
    slip: Positive = Field(0.15, description="metres, of a step that odometry did not see")
    slip_max_angle: Positive = Field(0.5, description="radians, the coarse gate after a slip")
    slip_angle: Positive = Field(0.25, description="radians, of a step that odometry did not see")
    sigma: Positive = Field(0.1, description="metres, of a pose found so, before its update")
    sigma_angle: Positive = Field(0.05, description="radians, of a pose found so")


class ForgetConfig(Section):
    """What is not seen again is forgotten."""

    patience: int = Field(6, ge=1, description="key scans unseen, for each sighting before")
    enough: int = Field(12, ge=2, description="sightings after which an object is kept for good")


class DoorConfig(Section):
    """When a narrow place is a door (or an opening between areas)."""

    min_width: Positive = Field(0.45, description="metres between the jambs, as passed")
    max_width: Positive = Field(
        1.7, description="metres between the jambs; up to 0.25 m more where there is more wall"
    )
    widening: Positive = Field(0.35, description="metres wider on either side of it")
    reach: Positive = Field(
        1.0, description="metres of path on which it must widen, or an open leaf's length"
    )
    min_evidence: Positive = Field(
        0.75,
        description="metres of wall on the line through the jambs, less metres of opening, for "
        "each metre of width (at least one)",
    )
    hysteresis: Positive = Field(0.4, description="metres beyond a known door to have crossed it")


class AreaConfig(Section):
    """When an area ends without a door."""

    max_objects: int = Field(300, ge=20, description="walls and ends in one area's state")
    max_extent: Positive = Field(40.0, description="metres from the area's frame")
    min_area: Positive = Field(5.0, description="square metres of free space that an area needs")
    opening: Positive = Field(
        0.8, description="metres; what is seen through a narrower one lies outside"
    )
    one_place: Positive = Field(
        0.5, lt=1.0, description="share of their ground in common with which two areas are one"
    )
    furniture: NonNegative = Field(1.2, description="metres; narrower gaps in it count as free")
    outline: Positive = Field(0.1, description="metres to which an area's outline is true")
    corridor_width: Positive = Field(3.5, description="metres; a corridor is nowhere wider")
    corridor_length: Positive = Field(4.0, description="widths; a corridor is longer")
    ask_every: Positive = Field(0.5, description="metres of path between questions where it is")
    ask_sigma: Positive = Field(1.0, description="metres of sigma within which areas are asked for")
    sure_sigma: Positive = Field(
        0.2, description="metres of sigma within which an answer as predicted suffices"
    )
    recent: int = Field(40, ge=1, description="key scans whose walls tell the area")
    least_walls: int = Field(4, ge=3, description="walls that must fit to know an area again")
    agree: Positive = Field(0.2, description="metres between two answers that agree")
    agree_angle: Positive = Field(0.06, description="radians between two answers that agree")
    agree_path: Positive = Field(0.4, description="metres of path between two witnesses")
    agree_path_old: Positive = Field(
        1.4, description="the same where the area left was not begun just now: a door comes first"
    )


class LoopConfig(Section):
    """Loops between fragments of the path, found when the log is known to its end."""

    enabled: bool = Field(True, description="false: no loop is closed")
    fragment_path: Positive = Field(5.0, description="metres of path that make a fragment")
    min_segment: Positive = Field(0.25, description="metres; shorter segments tell nothing")
    merge_offset: Positive = Field(0.08, description="metres between segments of one wall")
    merge_angle: Positive = Field(0.08, description="radians between segments of one wall")
    merge_gap: Positive = Field(0.3, description="metres unseen within one wall")
    min_wall: Positive = Field(0.3, description="metres of a wall that is matched")
    min_once: Positive = Field(1.0, description="metres of a wall that one scan alone has seen")
    chain_inflation: Positive = Field(2.5, description="of the path's variances")
    chain_floor: NonNegative = Field(0.03, description="metres added for each fragment")
    chain_floor_angle: NonNegative = Field(0.005, description="radians added for each fragment")
    broken_gate: Positive = Field(
        25.0, description="chi-square between the filter and the odometry, of a broken step"
    )
    broken_floor: Positive = Field(0.15, description="metres, likewise over a broken step")
    broken_floor_angle: Positive = Field(0.08, description="radians, likewise")
    step_floor: Positive = Field(0.05, description="metres that the filter may correct a step")
    step_floor_angle: Positive = Field(0.05, description="radians, likewise")
    near_distance: Positive = Field(6.0, description="metres between fragments that see the same")
    max_shift: Positive = Field(8.0, description="metres that a loop may move a fragment")
    max_turn: Positive = Field(0.6, description="radians that a loop may turn a fragment")
    window_sigmas: Positive = Field(3.0, description="within which a fragment is searched for")
    gate: Positive = Field(11.3, description="chi-square, 3 degrees, of a cycle that is closed")
    least_steps: int = Field(2, ge=1, description="fragments between those of a loop, at least")
    partners: int = Field(12, ge=1, description="earlier fragments that each one is matched with")
    max_angle: Positive = Field(0.07, description="radians between a wall and the same one")
    max_offset: Positive = Field(0.12, description="metres between a wall and the same one")
    least_sine: Positive = Field(0.4, lt=1, description="of the angle between walls not parallel")
    least_overlap: Positive = Field(0.2, description="metres of a wall on the same one")
    sigma_wall: Positive = Field(0.03, description="metres; a wall's unevenness, as merged")
    distinct: Positive = Field(0.4, description="metres between different places")
    distinct_angle: Positive = Field(0.12, description="radians between different places")
    min_overlap: Positive = Field(4.0, description="metres of wall on wall that make a loop")
    min_walls: int = Field(4, ge=2, description="walls of it")
    min_cross: Positive = Field(0.8, description="metres of it in the direction held least")
    min_pairs: int = Field(1, ge=1, description="pairs of walls not parallel, none in two pairs")
    max_crossing: Positive = Field(0.2, lt=1, description="share of beams that cross walls")
    through: Positive = Field(0.25, description="metres before and behind a wall that is crossed")
    second: Positive = Field(0.8, le=1, description="the second best place, of the best")
    loop_inflation: Positive = Field(4.0, description="of a loop's variances")
    loop_floor: NonNegative = Field(0.03, description="metres added to a loop's sigma")
    loop_floor_angle: NonNegative = Field(0.01, description="radians added to a loop's sigma")
    sure_sigma: Positive = Field(
        0.3, description="metres of sigma of a way that is a witness by itself"
    )
    sure_sigma_angle: Positive = Field(0.1, description="radians of sigma, likewise")
    near_sigma: Positive = Field(
        1.0, description="metres of sigma between loops that can be witnesses of each other"
    )
    near_fragments: int = Field(8, ge=1, description="fragments between such loops, at most")
    witness_gate: Positive = Field(
        4.5, description="chi-square, 3 degrees, of a cycle that only other loops are witness of"
    )
    witness_spread: Positive = Field(
        10.0, description="metres between loops that agree on what is unlikely"
    )
    witness_crossing: Positive = Field(
        0.12, lt=1, description="share of beams that cross walls, of such a loop and its witnesses"
    )
    alone_pairs: int = Field(
        4, ge=1, description="pairs of walls not parallel, of a loop that needs no witness"
    )
    alone_cross: Positive = Field(5.0, description="metres of it in the direction held least")
    alone_second: Positive = Field(0.25, le=1, description="the second best place, of it")
    alone_gate: Positive = Field(1.2, description="chi-square, 3 degrees, of its cycle")
    agree_gate: Positive = Field(11.3, description="chi-square of loops that ask for the same")
    agree: Positive = Field(0.15, description="metres between a loop and the filter, as witnesses")
    agree_angle: Positive = Field(0.05, description="radians, likewise")
    loss_scale: Positive = Field(3.0, description="sigmas at which a loop begins to count less")
    news: Positive = Field(
        0.7, lt=1, description="of its sigma, to which a place must be better known to ask again"
    )
    rounds: int = Field(16, ge=1, description="times that loops are asked for, at most")


class RefineConfig(Section):
    """The whole log gone over again, when the filter is through with it."""

    enabled: bool = Field(True, description="false: the filter alone (--no-refine)")
    scales: tuple[Positive, ...] = Field(
        (2.5, 1.0), description="of the offsets below, in each round of matching"
    )
    steps: int = Field(2, ge=1, description="of Gauss-Newton for each matching, at most")
    converged: Positive = Field(1e-4, description="metres and radians; a smaller step is the last")
    min_length: Positive = Field(0.3, description="metres; a segment that may be matched")
    match_angle: Positive = Field(0.1, description="radians between a segment and its wall")
    match_offset: Positive = Field(0.12, description="metres between a segment and its wall")
    overlap: Positive = Field(0.5, le=1, description="of a segment's length, with its wall")
    merge_angle: Positive = Field(0.06, description="radians between walls that are one")
    merge_offset: Positive = Field(0.08, description="metres between walls that are one")
    merge_overlap: Positive = Field(0.3, le=1, description="of the shorter wall, with the other")
    least_seen: int = Field(3, ge=2, description="sightings of a wall that is kept")
    end_gap: Positive = Field(0.1, description="metres between places where a wall ends")
    end_outlier: Positive = Field(16.0, description="chi-square of a place that is not the end")
    end_spread: Positive = Field(2.5, description="mean chi-square of the places of one end")
    end_seen: int = Field(3, ge=2, description="sightings of an end that is kept")
    end_bias: NonNegative = Field(
        0.2, description="of an end's sigma, the same in all scans from one side of it"
    )
    gate_odometry: Positive = Field(11.3, description="chi-square beyond which a step counts less")
    gate_wall: Positive = Field(9.2, description="chi-square beyond which a segment counts less")
    gate_end: Positive = Field(6.6, description="chi-square beyond which an end counts less")


class LandmarkConfig(Section):
    """Which groups of walls are landmarks (section 4), and which of them are kept."""

    end_seen: int = Field(3, ge=1, description="sightings after which a wall is known to end there")
    min_angle: Positive = Field(0.35, description="radians between the walls of a corner")
    corner_gap: Positive = Field(0.4, description="metres from a wall's end to the corner's vertex")
    corner_touch: Positive = Field(
        0.02, description="metres; sigma of where walls end that touch, beside the ends' own"
    )
    open_reach: Positive = Field(
        0.05, description="metres; sigma from where a wall was seen last to a corner"
    )
    corner_chi2: Positive = Field(
        6.0, description="of the ways from both ends to the vertex; more, and walls do not touch"
    )
    corner_known: Positive = Field(
        0.1, description="metres; no wall may stop shorter of the vertex, by two sigmas of its end"
    )
    parallel: Positive = Field(0.12, description="radians between walls that count as parallel")
    door_min_width: Positive = Field(0.6, description="metres between jambs")
    door_max_width: Positive = Field(1.4, description="metres between jambs; wider is no door")
    door_step: Positive = Field(0.2, description="metres from one jamb's wall line to the other's")
    recess: Positive = Field(1.2, description="metres; what closes a gap nearer makes it no door")
    jamb_radius: Positive = Field(
        0.4,
        description="metres from where the robot passed narrowly to a wall's end that is a jamb",
    )
    jamb_tilt: Positive = Field(0.4, description="radians from the jamb line to a wall along it")
    passage_max_width: Positive = Field(2.2, description="metres, of a passage that was crossed")
    passage_sigma: Positive = Field(0.05, description="metres; a door known by the way through it")
    passage_depth: Positive = Field(0.1, description="metres across the wall, likewise")
    passage_sigma_theta: Positive = Field(0.2, description="radians, likewise")
    corridor_min_width: Positive = Field(0.8, description="metres between parallel walls")
    corridor_max_width: Positive = Field(4.0, description="metres between parallel walls")
    corridor_min_length: Positive = Field(3.0, description="metres on which both walls were seen")
    corridor_ratio: Positive = Field(2.0, description="length over width of a corridor, at least")
    crossing_depth: Positive = Field(1.5, description="metres of a side corridor's walls")
    min_wall: Positive = Field(0.8, description="metres of a wall that is a landmark by itself")
    same: Positive = Field(0.25, description="metres within which two landmarks are one")
    prior_sigma: Positive = Field(0.1, description="metres; the robot before it sees the landmark")
    prior_sigma_theta: Positive = Field(0.05, description="radians, likewise")
    sighting_sigma: Positive = Field(0.03, description="metres; how well a wall is seen again")
    sighting_sigma_theta: Positive = Field(0.015, description="radians, likewise, of a long wall")
    least_seen: int = Field(2, ge=1, description="sightings; what was seen less is not kept")
    min_utility: NonNegative = Field(
        8.0, description="nats that a landmark takes off the robot's uncertainty, times sightings"
    )
