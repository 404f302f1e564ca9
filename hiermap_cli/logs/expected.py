"""About how many scans a log holds, for a progress bar: known or quickly counted, never exact."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hiermap_cli.logs.textfile import text_lines

if TYPE_CHECKING:
    from hiermap_cli.logs.recording import Recording

_TEXT_FORMATS = ("CARMEN", "Wean")


def expected_scans(recording: Recording) -> int | None:
    """The messages of the scans' topic, or the lines of it in a text log; None if unknown."""
    wanted = recording.scan_topic
    for topic in recording.source.topics():
        if topic.name == wanted and topic.messages is not None:
            return topic.messages
    if recording.source.format not in _TEXT_FORMATS:
        return None
    start = wanted.encode() + b" "
    return sum(
        line.startswith(start) for path in recording.source.paths for line in text_lines(path, [])
    )
