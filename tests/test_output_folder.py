"""The output folder: whole or not at all, and nobody's own folder is ever removed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hiermap_cli.documents import folder as module
from hiermap_cli.documents.folder import check_output, output_error, output_file, output_folder
from hiermap_cli.errors import EXIT_INPUT, EXIT_USAGE, OutputError, UsageError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write(target: Path, text: str, **options) -> None:
    with output_folder(target, **options) as new:
        (new / "model.json").write_text(text)
        (new / "sub").mkdir()
        (new / "sub" / "more.txt").write_text(text)


def test_a_new_folder(tmp_path):
    write(tmp_path / "a" / "out", "1")
    assert names(tmp_path / "a") == ["out"]
    assert names(tmp_path / "a" / "out") == ["model.json", "sub"]


def test_nothing_is_there_before_the_end(tmp_path):
    with output_folder(tmp_path / "out") as new:
        (new / "model.json").write_text("1")
        assert not (tmp_path / "out").exists()
        assert new.parent == tmp_path
    assert (tmp_path / "out").exists()


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, UsageError])
def test_a_failure_leaves_nothing(tmp_path, error):
    with pytest.raises(error), output_folder(tmp_path / "out") as new:
        (new / "model.json").write_text("1")
        raise error("no")
    assert names(tmp_path) == []


def test_an_existing_folder_needs_force(tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(UsageError, match="--force"):
        check_output(tmp_path / "out", force=False)
    write(tmp_path / "out", "1", force=True)  # an empty one may be replaced
    with pytest.raises(UsageError, match="--force"):
        write(tmp_path / "out", "2")
    assert (tmp_path / "out" / "model.json").read_text() == "1"
    write(tmp_path / "out", "2", force=True)
    assert (tmp_path / "out" / "model.json").read_text() == "2"
    assert names(tmp_path) == ["out"]


def test_a_failure_keeps_the_earlier_result(tmp_path):
    write(tmp_path / "out", "1")
    with pytest.raises(RuntimeError), output_folder(tmp_path / "out", force=True):
        raise RuntimeError
    assert (tmp_path / "out" / "model.json").read_text() == "1"
    assert names(tmp_path) == ["out"]


def test_a_failure_of_the_last_rename_puts_the_earlier_result_back(tmp_path, monkeypatch):
    write(tmp_path / "out", "1")
    rename = Path.rename

    def failing(self, target):
        if Path(target).name == "out" and (self / "model.json").read_text() == "2":
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OutputError):
        write(tmp_path / "out", "2", force=True)
    monkeypatch.undo()
    assert (tmp_path / "out" / "model.json").read_text() == "1"
    assert names(tmp_path) == ["out"]


def test_somebody_elses_folder_is_never_replaced(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    with pytest.raises(UsageError, match=r"chapter\.tex"):
        write(tmp_path / "thesis", "1", force=True)
    assert names(tmp_path / "thesis") == ["chapter.tex"]


def test_a_folder_with_the_input_is_never_replaced(tmp_path):
    (tmp_path / "out").mkdir()
    for name in ("log.mcap", "model.json"):
        (tmp_path / "out" / name).write_text("1")
    with pytest.raises(UsageError, match=r"log\.mcap"):
        write(tmp_path / "out", "1", force=True, inputs=[tmp_path / "out" / "log.mcap"])
    assert (tmp_path / "out" / "log.mcap").exists()


def test_the_working_folder_is_never_replaced(tmp_path, monkeypatch):
    (tmp_path / "model.json").write_text("1")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="working folder"):
        write(Path(), "1", force=True)


def test_a_file_is_never_replaced_by_a_folder(tmp_path):
    (tmp_path / "out").write_text("1")
    with pytest.raises(UsageError, match="is a file"):
        write(tmp_path / "out", "1", force=True)


def test_a_link_is_followed(tmp_path):
    write(tmp_path / "real", "1")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write(tmp_path / "link", "2", force=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "model.json").read_text() == "2"


def test_a_parent_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("1")
    with pytest.raises(UsageError, match="cannot be written"):
        check_output(tmp_path / "file" / "out", force=False)


def test_asking_makes_nothing(tmp_path):
    check_output(tmp_path / "a" / "b" / "out", force=False)
    assert names(tmp_path) == []


def test_a_parent_that_takes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # as on a disk that is read-only
    with pytest.raises(UsageError, match="no new files"):
        check_output(tmp_path / "a" / "out", force=False)


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_parent_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(UsageError, match="no new files"):
            check_output(tmp_path / "out", force=False)
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize(
    ("number", "kind", "status"),
    [
        (errno.ENOSPC, OutputError, EXIT_INPUT),
        (errno.EIO, OutputError, EXIT_INPUT),
        (errno.EROFS, UsageError, EXIT_USAGE),
        (errno.EACCES, UsageError, EXIT_USAGE),
        (errno.ENAMETOOLONG, UsageError, EXIT_USAGE),
    ],
)
def test_what_the_system_says_becomes_one_line(tmp_path, number, kind, status):
    with pytest.raises(kind) as caught, output_folder(tmp_path / "out"):
        raise OSError(number, os.strerror(number))
    assert caught.value.exit_status == status
    assert "\n" not in str(caught.value)
    assert os.strerror(number) in str(caught.value)
    assert names(tmp_path) == []


def test_a_folder_that_appears_meanwhile_is_not_replaced(tmp_path):
    with pytest.raises(UsageError), output_folder(tmp_path / "out") as new:
        (new / "model.json").write_text("1")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "other").write_text("2")
    assert names(tmp_path / "out") == ["other"]


def test_temporary_names_never_meet(tmp_path, monkeypatch):
    tokens = iter(["aa", "aa", "bb"])
    monkeypatch.setattr(module.secrets, "token_hex", lambda _: next(tokens))
    first = module._new_folder(tmp_path, "out")
    second = module._new_folder(tmp_path, "out")
    assert first.name != second.name


def test_a_file_is_replaced_in_one_step(tmp_path):
    path = tmp_path / "sub" / "a.json"
    with output_file(path) as new:
        new.write_text("1")
        assert not path.exists()
    with pytest.raises(RuntimeError), output_file(path) as new:
        new.write_text("2")
        raise RuntimeError
    assert path.read_text() == "1"
    assert names(path.parent) == ["a.json"]


def test_a_file_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("1")
    with pytest.raises(UsageError), output_file(tmp_path / "file" / "a.json") as new:
        new.write_text("2")


def test_an_error_without_words_is_still_one_line():
    assert "odd" in str(output_error(Path("a"), OSError("odd")))
