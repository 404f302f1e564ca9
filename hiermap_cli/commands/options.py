"""The options that `run`, `inspect` and `convert` share: which log, and what of it.

@click.command("run")
@log_options
def command(logs: tuple[Path, ...], chosen: InputOptions, ...) -> None:
    config = ...
    open_recording(logs, chosen.over(config.input))
"""

from __future__ import annotations

import math
from functools import wraps
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from hiermap_cli.commands.common_options import PATH

if TYPE_CHECKING:
    from collections.abc import Callable

    from hiermap_cli.config import InputConfig


class MountValue(NamedTuple):
    """What --mount says: metres, metres, radians, and whether the laser is upside down."""

    x: float
    y: float
    yaw: float
    flipped: bool


def parse_mount(text: str) -> MountValue:
    """The mount in a text such as `0.1,0,3.14,flipped`.

    Raises:
        ValueError: it is no `x,y,yaw` nor `x,y,yaw,flipped`.
    """
    words = [word.strip() for word in text.split(",")]
    flipped = words[3:] == ["flipped"]
    if len(words) != 3 + flipped:
        raise ValueError(text)
    x, y, yaw = (float(word) for word in words[:3])
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ValueError(text)
    return MountValue(x, y, yaw, flipped)


def _mount(ctx: click.Context, param: click.Parameter, text: str | None) -> MountValue | None:
    if text is None:
        return None
    try:
        return parse_mount(text)
    except ValueError:
        raise click.BadParameter(
            f"{text!r} is not x,y,yaw in metres and radians, nor x,y,yaw,flipped", ctx, param
        ) from None


class InputOptions(NamedTuple):
    """What the options say; None where they say nothing."""

    scan_topic: str | None = None
    odometry_topic: str | None = None
    mount: MountValue | None = None
    start: float | None = None
    end: float | None = None

    def over(self, base: InputConfig) -> InputConfig:
        """`base` with what the options say instead.

        Raises:
            UsageError: --start is not before --end.
        """
        from hiermap_cli.config import MountConfig
        from hiermap_cli.errors import UsageError

        said: dict[str, Any] = {k: v for k, v in self._asdict().items() if v is not None}
        if self.mount is not None:
            said["mount"] = MountConfig(**self.mount._asdict())
        chosen = base.model_copy(update=said)
        if chosen.start is not None and chosen.end is not None and chosen.start >= chosen.end:
            raise UsageError(f"--start {chosen.start:g} is not before --end {chosen.end:g}")
        return chosen


def log_options(function: Callable[..., None]) -> Callable[..., None]:
    """Adds LOG... and the options of `InputOptions`; the command gets `logs` and `chosen`."""

    @wraps(function)
    def command(**values: Any) -> None:
        chosen = InputOptions(**{name: values.pop(name) for name in InputOptions._fields})
        function(logs=tuple(values.pop("logs")), chosen=chosen, **values)

    for decorate in reversed(_OPTIONS):
        command = decorate(command)
    return command


_OPTIONS = (
    click.argument("logs", nargs=-1, required=True, metavar="LOG...", type=PATH),
    click.option("--scan-topic", metavar="NAME", help="Topic of the scans, where several fit."),
    click.option(
        "--odom-topic",
        "odometry_topic",
        metavar="NAME",
        help="Topic of the odometry, or a transform as in /tf:odom->base_link.",
    ),
    click.option(
        "--mount",
        callback=_mount,
        metavar="x,y,yaw[,flipped]",
        help="Pose of the laser on the robot in metres and radians, instead of the log's.",
    ),
    click.option(
        "--start",
        type=click.FloatRange(min=0.0),
        metavar="S",
        help="Seconds after the first stamp.",
    ),
    click.option(
        "--end", type=click.FloatRange(min=0.0), metavar="S", help="Seconds after the first stamp."
    ),
)
