"""The filter over a whole log: the noise learnt at its beginning, then every scan in its order."""

from __future__ import annotations

import time
from itertools import chain
from typing import TYPE_CHECKING

from hiermap_cli.estimation.noise import NoiseScale
from hiermap_cli.mapping.mapper import Mapper
from hiermap_cli.perception.seen import SeenBlock, parted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from hiermap_cli.config import Config
    from hiermap_cli.logs.records import ScanBlock

WARM_UP_BLOCKS = 16  # of `PART` scans at most, however little the robot moves


def run_filter(
    blocks: Iterable[ScanBlock], config: Config, progress: Callable[[int], None] | None = None
) -> tuple[Mapper, dict[str, float]]:
    """The filter over the whole log; returns the mapper and the seconds of each stage.

    progress: told the number of scans worked off, within the blocks too.
    """
    started = time.process_time()
    stream = iter(blocks)
    first, noise = learn_noise(stream, config)
    learnt = time.process_time()
    mapper = Mapper(
        config, noise=noise, noise_rate=config.noise.rate if config.noise.estimate else 0.0
    )
    for seen in chain(first, (SeenBlock(block, config) for block in stream)):
        mapper.take(seen.block, seen, progress)
    mapper.finish()
    return mapper, {"noise": learnt - started, "filter": time.process_time() - learnt}


def learn_noise(stream: Iterator[ScanBlock], config: Config) -> tuple[list[SeenBlock], NoiseScale]:
    """The blocks at the log's beginning, and how large the noise is by a first run over them.

    So that the first walls are not entered with a noise that later proves wrong. The first run is
    in one area, whatever doors lie on the way: the walls behind them tell of the noise as well.
    """
    first: list[SeenBlock] = []
    if not config.noise.estimate or not config.noise.warm_up:
        return first, NoiseScale()
    scout = Mapper(config, noise_rate=config.noise.warm_up_rate, one_area=True)
    for block in stream:
        parts = parted(block, config)
        if not first:
            scout.noise = NoiseScale(laser=parts[0].laser_factor())
        first += parts
        for seen in parts:
            scout.take(seen.block, seen)
            if scout.counts.keys >= config.noise.warm_up:
                return first, scout.noise
        if len(first) >= WARM_UP_BLOCKS:
            break
    return first, scout.noise
