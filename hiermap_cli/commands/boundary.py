"""The one place where errors end: each becomes one line on stderr and an exit status.

Errors that hiermap raises on purpose say themselves what is wrong. Anything else is a fault of
the program: its traceback goes into a file beside the output, or to stderr with -v.
"""

from __future__ import annotations

import errno
import os
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from hiermap_cli.errors import (
    EXIT_FAULT,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    EXIT_OK,
    ConfigurationError,
    HiermapError,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class Session:
    """What the boundary must know of the command that runs.

    verbose: tracebacks go to stderr. beside: the folder for their file, or None for the working
    folder.
    """

    verbose: bool = False
    beside: Path | None = None


def session() -> Session:
    """The session of the command that runs now."""
    return click.get_current_context().ensure_object(Session)


@contextmanager
def boundary(state: Session) -> Iterator[None]:
    """Runs a command; whatever it raises ends in `click.exceptions.Exit` with its status."""
    try:
        yield
    except (click.ClickException, click.exceptions.Exit):
        raise  # wrong usage, which click words itself, or an exit status
    except HiermapError as error:
        _say_expected(error)
        raise click.exceptions.Exit(error.exit_status) from None
    except (KeyboardInterrupt, click.Abort):
        _say("interrupted")
        raise click.exceptions.Exit(EXIT_INTERRUPTED) from None
    except BrokenPipeError:
        # Whoever read our stdout has seen enough, as `| head` does.
        silence(sys.stdout.fileno())
        raise click.exceptions.Exit(EXIT_OK) from None
    except PermissionError as error:
        _say(f"{error.filename or 'a file'}: cannot be used ({error.strerror})")
        raise click.exceptions.Exit(EXIT_INPUT) from None
    except OSError as error:
        if error.errno != errno.ENOSPC:
            _say_fault(error, state)
            raise click.exceptions.Exit(EXIT_FAULT) from None
        _say(f"{error.filename or 'the output'}: cannot be written ({error.strerror})")
        raise click.exceptions.Exit(EXIT_INPUT) from None
    except Exception as error:  # noqa: BLE001 - the boundary
        _say_fault(error, state)
        raise click.exceptions.Exit(EXIT_FAULT) from None


def silence(descriptor: int) -> None:
    """Sends what is still buffered for a closed pipe to nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _say(text: str) -> None:
    click.echo(f"hiermap: {text}", err=True)


def _say_expected(error: HiermapError) -> None:
    if isinstance(error, ConfigurationError):
        for fault in error.faults:
            _say(f"{error.source}: {one_line(fault)}")
    else:
        _say(one_line(str(error)))


def one_line(text: str) -> str:
    """The text on one line, without control characters that a damaged input may carry."""
    return "".join(c if c.isprintable() else " " for c in " ".join(text.split()))


def _say_fault(error: Exception, state: Session) -> None:
    import traceback

    text = "".join(traceback.format_exception(error))
    what = one_line(f"{type(error).__name__}: {error}")[:300]
    if state.verbose:
        click.echo(text, err=True, nl=False)
        _say(f"a fault of the program ({what})")
        return
    path = _write_traceback(text, state.beside)
    where = f"the traceback is in {path}" if path else "run again with -v for the traceback"
    _say(f"a fault of the program ({what}); {where}")


def _write_traceback(text: str, beside: Path | None) -> Path | None:
    """The file that holds the traceback, or None where no folder takes it."""
    import tempfile
    from pathlib import Path

    name = f"hiermap-traceback-{time.strftime('%Y%m%dT%H%M%S')}-{os.getpid()}.txt"
    for folder in (beside or Path(), Path(tempfile.gettempdir())):
        try:
            (folder / name).write_text(text, encoding="utf-8", errors="backslashreplace")
        except OSError:
            continue  # not there: the next place
        return folder / name
    return None
