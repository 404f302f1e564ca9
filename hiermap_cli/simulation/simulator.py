"""A world and a source of chance become a log: odometry and scans, with the truth beside them.

Scans are cast when they are asked for, block by block, so that a long simulation takes no more
memory than its trajectory. Odometry, ranges and people each have a generator of their own,
seeded from the one passed in: people more or less do not change the odometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hiermap_cli.documents.reference import reference_document
from hiermap_cli.logs.records import ScanBlock
from hiermap_cli.simulation.odometry import read_wheels
from hiermap_cli.simulation.people import STEP, Walks, walk
from hiermap_cli.simulation.raycast import RayCaster
from hiermap_cli.simulation.reference import reference_map

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hiermap_cli.documents.reference import ReferenceMap
    from hiermap_cli.logs.records import LaserGeometry
    from hiermap_cli.simulation.world import World

    Array = NDArray[np.float64]
    Stamps = NDArray[np.int64]

BLOCK = 256  # scans


@dataclass(frozen=True, slots=True)
class Simulation:
    """What a simulated robot lived through; N scans, M readings of the odometry.

    stamps_ns: (N,) int64 of the scans. truth: (N, 3) the robot at each, in the world frame.
    odometry_ns: (M,) int64, among them every stamp of a scan; odometry: (M, 3) in a frame that
        begins at the first reading.
    at_scan: (N,) index of the reading at each scan.
    reference_map: the building as it is, in the world frame, and where the robot was.
    walks: the people. seed: of the ranges' noise, None without noise.
    """

    world: World
    stamps_ns: Stamps
    truth: Array
    odometry_ns: Stamps
    odometry: Array
    at_scan: NDArray[np.int64]
    reference_map: ReferenceMap
    walks: Walks | None
    seed: tuple[int, ...] | None

    @property
    def laser(self) -> LaserGeometry:
        """The beams of every scan."""
        return self.world.laser

    @property
    def reference(self) -> dict[str, Any]:
        """The document reference.json of formats.md, in the world frame."""
        return reference_document(self.reference_map)

    def blocks(self, size: int = BLOCK) -> Iterator[ScanBlock]:
        """All scans in blocks of `size`, each time the same, whatever the size."""
        laser, spec = self.world.spec.laser, self.world.spec
        rng = None if self.seed is None else np.random.default_rng(self.seed)
        caster = RayCaster(self.world.plan.faces(), self.laser, self.world.mount)
        for first in range(0, len(self.stamps_ns), size):
            chunk = slice(first, first + size)
            stamps_ns = self.stamps_ns[chunk]
            discs = None
            if self.walks is not None:
                discs = self.walks.at(_seconds(stamps_ns, self.stamps_ns[0]))
            ranges = caster.ranges(self.truth[chunk], discs, spec.people.radius)
            if rng is not None:
                noise = rng.standard_normal(ranges.shape)
                sigma = laser.sigma + laser.sigma_per_metre * np.minimum(ranges, laser.range_max)
                ranges = ranges + sigma * noise
                ranges[ranges > laser.range_max] = np.inf
            ranges[ranges < laser.range_min] = np.nan
            yield ScanBlock(
                stamps_ns=stamps_ns,
                ranges=ranges.astype(np.float32),
                odometry=self.odometry[self.at_scan[chunk]],
                has_odometry=np.ones(len(stamps_ns), dtype=bool),
                laser=self.laser,
                mount=self.world.stated_mount,
            )


def simulate(world: World, rng: np.random.Generator, *, noiseless: bool = False) -> Simulation:
    """The robot's journey through a world.

    Args:
        world: from `load_world` or `build_world`.
        rng: the only source of chance; the same state gives the same log to the byte.
        noiseless: exact wheels and ranges; people walk all the same, and constant faults and
            bends of the odometry stay, as they are the world's.
    """
    spec, journey = world.spec, world.journey
    seeds = [tuple(int(v) for v in rng.integers(0, 2**32, size=4)) for _ in range(3)]
    start_ns = round(spec.start * 1e9)
    end_ns = start_ns + int(journey.end * 1e9)
    stamps_ns = np.arange(start_ns, end_ns + 1, round(1e9 / spec.laser.rate), dtype=np.int64)
    readings_ns = np.arange(start_ns, end_ns + 1, round(1e9 / spec.odometry.rate), dtype=np.int64)
    odometry_ns = np.union1d(stamps_ns, readings_ns)
    odometry = read_wheels(
        journey,
        _seconds(odometry_ns, start_ns),
        spec.odometry,
        None if noiseless else np.random.default_rng(seeds[0]),
    )
    truth = journey.poses(_seconds(stamps_ns, start_ns))
    walks = None
    if spec.people.number:
        moments = np.arange(0.0, journey.end + STEP, STEP)
        people_rng = np.random.default_rng(seeds[2])
        robot = journey.poses(moments)[:, :2]
        walks = walk(world.plan, spec.people, robot, spec.robot.radius, people_rng)
    simulation = Simulation(
        world=world,
        stamps_ns=stamps_ns,
        truth=truth,
        odometry_ns=odometry_ns,
        odometry=odometry,
        at_scan=np.searchsorted(odometry_ns, stamps_ns),
        reference_map=reference_map(world.plan, truth[:, :2]),
        walks=walks,
        seed=None if noiseless else seeds[1],
    )
    for array in (stamps_ns, truth, odometry_ns, odometry, simulation.at_scan):
        array.flags.writeable = False
    return simulation


def _seconds(stamps_ns: Stamps, start_ns: int | np.int64) -> Array:
    """Seconds since the start."""
    return np.asarray(stamps_ns - start_ns, dtype=np.float64) * 1e-9
