"""Which files hiermap itself has written, told by their name and by how they begin.

What is replaced is lost, so that a name alone proves nothing: model.json and log.mcap are names
that other programs use too. A JSON document of ours begins with its `format` key.
"""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    Patterns = Mapping[str, bytes]

_HEAD = 4096  # bytes; a recording is not read whole to see what it is
_TRACEBACK = re.compile(r"hiermap-traceback-[0-9T]+-[0-9]+\.txt")
_UNFINISHED = re.compile(r"\.(.+)\.[0-9a-f]{8}(\.part)?")

EVAL = "eval.json"
EVAL_FORMAT = "hiermap-eval"

# How files of ours begin that are no JSON.
TUM = rb"-?\d+\.\d{9}( -?\d+\.\d{9}){2} 0 0 0( -?\d\.\d{12}){2}\n"
COVARIANCES = rb"-?\d+\.\d{9}( -?\d\.\d{14}e[-+]\d+){6}\n"
PICTURE = (
    rb'<svg xmlns="http://www\.w3\.org/2000/svg" width="\d+" height="\d+" '
    rb'viewBox="0 0 \d+ \d+" font-family="Helvetica, Arial, sans-serif">'
)
MARKDOWN = rb"##+ hiermap (eval|compare|batch): "
JUNIT = rb'<testsuites name="hiermap (eval|compare|batch)"'
# The header of an MCAP: magic, opcode and length of the record, profile, library.
MCAP = rb"\x89MCAP0\r\n\x01[\s\S]{8}\x04\0\0\0ros2[\s\S]{4}hiermap "


def document(name: str) -> bytes:
    """How a JSON document of the format `name` begins."""
    return rb'\s*\{\s*"format"\s*:\s*"' + re.escape(name).encode() + rb'"'


def begins(path: Path, pattern: bytes) -> bool:
    """Whether a file is a regular one that begins as `pattern` says, or an empty one.

    One that cannot be read is not: nobody can say whose it is.
    """
    try:
        if path.is_symlink() or not path.is_file():
            return False
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError:
        return False
    return not head or re.match(pattern, head) is not None


class Contents(NamedTuple):
    """What a folder holds that a command has written.

    what: in words for a person. needed: files without which a folder is no such one. files: the
    names of all files that may be there, each with how it begins.
    """

    what: str
    needed: tuple[str, ...]
    files: Patterns

    def fault(self, folder: Path) -> str | None:
        """Why `folder` is not this and nothing else, in a few words; None where it is.

        Raises:
            OSError: the folder cannot be read.
        """
        names = sorted(os.listdir(folder))  # noqa: PTH208 - names alone
        for name in names:
            if name not in self.files:
                if not (self._is_left_over(name) and (folder / name).is_file()):
                    return f"holds {name}, which is no part of {self.what}"
            elif not begins(folder / name, self.files[name]):
                return f"holds a {name} that hiermap did not write"
        missing = [name for name in self.needed if name not in names]
        return f"holds no {missing[0]}, so it is not {self.what}" if missing else None

    def _is_left_over(self, name: str) -> bool:
        """Whether a fault of the program, or a command that was killed, leaves this name."""
        found = _UNFINISHED.fullmatch(name)
        return _TRACEBACK.fullmatch(name) is not None or (
            found is not None and found[1] in self.files
        )


class Output(NamedTuple):
    """A file that a command is to write.

    option: which says so; own: how the file begins where an earlier one may be replaced.
    """

    option: str
    path: Path
    own: bytes


def is_same_file(first: Path, second: Path) -> bool:
    """Whether two paths lead to one file, be it there or not."""
    try:
        return first.samefile(second)
    except OSError:  # one of them is not there
        return os.path.realpath(first) == os.path.realpath(second)


def output_fault(outputs: Iterable[Output], inputs: Iterable[Path]) -> str | None:
    """Why files may not be written, as one line; None where all may.

    None of them may be an input, or another of them, or a file that hiermap did not write.
    """
    inputs, before = list(inputs), list[Output]()
    for output in outputs:
        option, path, own = output
        if os.path.isdir(path):  # noqa: PTH112 - raises nothing
            return f"{path}: is a folder; name a file with {option}"
        if any(is_same_file(path, one) for one in inputs):
            return f"{path}: is an input; choose another file with {option}"
        for other in before:
            if is_same_file(path, other.path):
                return f"{path}: is named by {other.option} and {option}; give each its own file"
        real = type(path)(os.path.realpath(path))
        if os.path.exists(path) and not begins(real, own):  # noqa: PTH110 - raises nothing
            return (
                f"{path}: exists and is none that {option} writes; "
                f"move it elsewhere or choose another file with {option}"
            )
        before.append(output)
    return None
