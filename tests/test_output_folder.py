"""The output folder: whole or not at all, and nobody's own folder is ever removed."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hiermap_cli.documents import folder as module
from hiermap_cli.documents.folder import check_files, check_output, output_file, output_folder
from hiermap_cli.documents.own_files import Contents, Output, begins, document
from hiermap_cli.errors import EXIT_INPUT, EXIT_USAGE, OutputError, UsageError, output_error


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


OURS = Contents(
    "an earlier result", ("model.json",), {"model.json": document("hiermap-model"), "a.txt": b"a"}
)


def model(text: str) -> str:
    return f'{{"format": "hiermap-model", "text": {text}}}'


def write(target: Path, text: str, **options) -> None:
    with output_folder(target, OURS, **options) as new:
        (new / "model.json").write_text(model(text))
        (new / "a.txt").write_text("a")


def test_a_new_folder(tmp_path):
    write(tmp_path / "a" / "out", "1")
    assert names(tmp_path / "a") == ["out"]
    assert names(tmp_path / "a" / "out") == ["a.txt", "model.json"]


def test_nothing_is_there_before_the_end(tmp_path):
    with output_folder(tmp_path / "out", OURS) as new:
        (new / "model.json").write_text("1")
        assert not (tmp_path / "out").exists()
        assert new.parent == tmp_path
    assert (tmp_path / "out").exists()


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, UsageError])
def test_a_failure_leaves_nothing(tmp_path, error):
    with pytest.raises(error), output_folder(tmp_path / "out", OURS) as new:
        (new / "model.json").write_text("1")
        raise error("no")
    assert names(tmp_path) == []


def test_an_existing_result_needs_force(tmp_path):
    write(tmp_path / "out", "1")
    with pytest.raises(UsageError, match="exists already; --force replaces it"):
        write(tmp_path / "out", "2")
    assert (tmp_path / "out" / "model.json").read_text() == model("1")
    write(tmp_path / "out", "2", force=True)
    assert (tmp_path / "out" / "model.json").read_text() == model("2")
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize("force", [False, True])
def test_an_empty_folder_is_used(tmp_path, force):
    (tmp_path / "out").mkdir()
    check_output(tmp_path / "out", OURS, force=force)
    write(tmp_path / "out", "1", force=force)
    assert names(tmp_path / "out") == ["a.txt", "model.json"]
    assert names(tmp_path) == ["out"]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("notes.txt", "mine", "holds notes.txt, which is no part of an earlier result"),
        (".git", "mine", "holds .git, which"),
        ("model.json", '{"class_name": "Sequential"}', "holds a model.json that hiermap did not"),
        ("a.txt", "b", "holds a a.txt that hiermap did not write"),
        (".notes.txt.0123abcd", "mine", "which is no part of"),
    ],
)
@pytest.mark.parametrize("force", [False, True])
def test_a_foreign_file_is_never_removed(tmp_path, name, text, said, force):
    write(tmp_path / "out", "1")
    (tmp_path / "out" / name).write_text(text)
    with pytest.raises(UsageError) as caught:
        write(tmp_path / "out", "2", force=force)
    assert said in str(caught.value)
    assert "is never replaced: move it elsewhere" in str(caught.value)
    assert (tmp_path / "out" / name).read_text() == text
    assert names(tmp_path) == ["out"]


def test_a_foreign_folder_or_link_is_never_removed(tmp_path):
    write(tmp_path / "out", "1")
    (tmp_path / "elsewhere").write_text("a")
    (tmp_path / "out" / "a.txt").unlink()
    (tmp_path / "out" / "a.txt").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match=r"a\.txt"):
        write(tmp_path / "out", "2", force=True)
    (tmp_path / "out" / "a.txt").unlink()
    (tmp_path / "out" / "data").mkdir()
    with pytest.raises(UsageError, match="holds data"):
        write(tmp_path / "out", "2", force=True)
    assert names(tmp_path / "out") == ["data", "model.json"]


def test_what_lacks_the_document_is_no_earlier_result(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.txt").write_text("a")
    with pytest.raises(UsageError, match=r"holds no model\.json, so it is not an earlier result"):
        write(tmp_path / "out", "1", force=True)
    assert names(tmp_path / "out") == ["a.txt"]


def test_what_a_killed_command_left_in_a_result_goes_with_it(tmp_path):
    write(tmp_path / "out", "1")
    for name in (".a.txt.0123abcd", "hiermap-traceback-20260102T030405-12.txt"):
        (tmp_path / "out" / name).write_text("half")
    write(tmp_path / "out", "2", force=True)
    assert names(tmp_path / "out") == ["a.txt", "model.json"]


def test_a_foreign_file_that_comes_meanwhile_stays(tmp_path):
    write(tmp_path / "out", "1")
    with (
        pytest.raises(UsageError, match=r"notes\.txt"),
        output_folder(tmp_path / "out", OURS, force=True) as new,
    ):
        (new / "model.json").write_text(model("2"))
        (tmp_path / "out" / "notes.txt").write_text("mine")
    assert names(tmp_path / "out") == ["a.txt", "model.json", "notes.txt"]
    assert names(tmp_path) == ["out"]


def test_a_foreign_file_that_comes_at_the_last_moment_stays(tmp_path, monkeypatch):
    write(tmp_path / "out", "1")
    rename = Path.rename

    def late(self, target):
        if self.name == "out":
            (self / "notes.txt").write_text("mine")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", late)
    with pytest.raises(UsageError, match=r"out: holds notes\.txt"):
        write(tmp_path / "out", "2", force=True)
    assert names(tmp_path / "out") == ["a.txt", "model.json", "notes.txt"]
    assert names(tmp_path) == ["out"]


def test_a_failure_keeps_the_earlier_result(tmp_path):
    write(tmp_path / "out", "1")
    with pytest.raises(RuntimeError), output_folder(tmp_path / "out", OURS, force=True):
        raise RuntimeError
    assert (tmp_path / "out" / "model.json").read_text() == model("1")
    assert names(tmp_path) == ["out"]


def test_a_failure_of_the_last_rename_puts_the_earlier_result_back(tmp_path, monkeypatch):
    write(tmp_path / "out", "1")
    rename = Path.rename

    def failing(self, target):
        if Path(target).name == "out" and (self / "model.json").read_text() == model("2"):
            raise OSError(errno.EIO, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OutputError):
        write(tmp_path / "out", "2", force=True)
    monkeypatch.undo()
    assert (tmp_path / "out" / "model.json").read_text() == model("1")
    assert names(tmp_path) == ["out"]


def test_somebody_elses_folder_is_never_replaced(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("years of work")
    with pytest.raises(UsageError, match=r"chapter\.tex"):
        write(tmp_path / "thesis", "1", force=True)
    assert names(tmp_path / "thesis") == ["chapter.tex"]


def test_a_folder_with_the_input_is_never_replaced(tmp_path):
    (tmp_path / "out").mkdir()
    for name in ("a.txt", "model.json"):
        (tmp_path / "out" / name).write_text("")
    with pytest.raises(UsageError, match=r"holds the input .*a\.txt"):
        write(tmp_path / "out", "1", force=True, inputs=[tmp_path / "out" / "a.txt"])
    assert (tmp_path / "out" / "a.txt").exists()


def test_the_working_folder_is_never_replaced(tmp_path, monkeypatch):
    (tmp_path / "model.json").write_text(model("1"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="working folder"):
        write(Path(), "1", force=True)


@pytest.mark.parametrize("force", [False, True])
def test_a_file_is_never_replaced_by_a_folder(tmp_path, force):
    (tmp_path / "out").write_text("1")
    with pytest.raises(UsageError, match="is a file"):
        write(tmp_path / "out", "1", force=force)


def test_a_place_that_no_force_frees_says_so(monkeypatch, tmp_path):
    with pytest.raises(UsageError, match="is the working folder or one above it"):
        write(Path("/"), "1")
    monkeypatch.setattr(os.path, "ismount", lambda _: True)  # as a volume of a container is
    (tmp_path / "out").mkdir()
    with pytest.raises(UsageError, match="is a mount point; choose a folder in it"):
        write(tmp_path / "out", "1")


def test_a_link_is_followed(tmp_path):
    write(tmp_path / "real", "1")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    write(tmp_path / "link", "2", force=True)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "model.json").read_text() == model("2")


def test_a_parent_that_is_a_file(tmp_path):
    (tmp_path / "file").write_text("1")
    with pytest.raises(UsageError, match="cannot be written"):
        check_output(tmp_path / "file" / "out", OURS, force=False)


def test_asking_makes_nothing(tmp_path):
    check_output(tmp_path / "a" / "b" / "out", OURS, force=False)
    assert names(tmp_path) == []


def test_a_parent_that_takes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # as on a disk that is read-only
    with pytest.raises(UsageError, match="no new files"):
        check_output(tmp_path / "a" / "out", OURS, force=False)


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes anywhere")
def test_a_parent_without_permission(tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(UsageError, match="no new files"):
            check_output(tmp_path / "out", OURS, force=False)
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
    with pytest.raises(kind) as caught, output_folder(tmp_path / "out", OURS):
        raise OSError(number, os.strerror(number))
    assert caught.value.exit_status == status
    assert "\n" not in str(caught.value)
    assert os.strerror(number) in str(caught.value)
    assert names(tmp_path) == []


def test_a_folder_that_appears_meanwhile_is_not_replaced(tmp_path):
    with pytest.raises(UsageError), output_folder(tmp_path / "out", OURS) as new:
        (new / "model.json").write_text("1")
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "other").write_text("2")
    assert names(tmp_path / "out") == ["other"]


def test_temporary_names_never_meet(tmp_path, monkeypatch):
    tokens = iter([b"aaaa", b"aaaa", b"bbbb"])
    monkeypatch.setattr(module.os, "urandom", lambda _: next(tokens))
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


OURS_FILE = document("hiermap-eval")


@pytest.mark.parametrize(
    ("head", "own"),
    [
        ('{"format":"hiermap-eval"}', True),
        ('{\n "format": "hiermap-eval",', True),
        ("", True),
        ('{"format":"hiermap-evaluation"}', False),
        ('{"a": 1, "format": "other"}', False),
        ("# notes", False),
    ],
)
def test_a_file_of_ours_is_told_by_its_beginning(tmp_path, head, own):
    (tmp_path / "eval.json").write_text(head)
    assert begins(tmp_path / "eval.json", OURS_FILE) is own
    assert not begins(tmp_path, OURS_FILE)
    assert not begins(tmp_path / "none", OURS_FILE)


def test_an_output_is_no_input_and_no_other_output(tmp_path):
    given, other, ours = tmp_path / "t.tum", tmp_path / "b.md", tmp_path / "eval.json"
    given.write_text("0 0 0 0 0 0 0 1\n")
    (tmp_path / "soft").symlink_to(given)
    os.link(given, tmp_path / "hard")
    ours.write_text('{"format": "hiermap-eval"}')
    check_files([Output("-o", ours, OURS_FILE), Output("--summary", other, b"#")], [given])
    for path in (given, tmp_path / "soft", tmp_path / "hard"):
        with pytest.raises(UsageError, match="is an input; choose another file with --junit"):
            check_files([Output("--junit", path, b"")], [given])
    with pytest.raises(UsageError, match="is named by -o and --summary"):
        check_files([Output("-o", other, b""), Output("--summary", other, b"")], [])
    with pytest.raises(UsageError, match="is a folder; name a file with -o"):
        check_files([Output("-o", tmp_path, b"")], [])


def test_a_foreign_file_is_no_output(tmp_path):
    (tmp_path / "notes.md").write_text("years of work")
    os.mkfifo(tmp_path / "pipe")  # as a device it must not become a file
    for path in (tmp_path / "notes.md", tmp_path / "pipe"):
        with pytest.raises(UsageError, match="exists and is none that --summary writes"):
            check_files([Output("--summary", path, b"### hiermap")], [])
    with pytest.raises(UsageError, match="choose another place with --summary"):
        check_files([Output("--summary", tmp_path / "notes.md" / "a", b"")], [])


def test_an_output_that_cannot_be_written_names_its_option(tmp_path):
    with (
        pytest.raises(UsageError, match="another place with --summary"),
        output_file(tmp_path / "a", "--summary"),
    ):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))
