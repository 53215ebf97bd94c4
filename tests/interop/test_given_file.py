import os
from pathlib import Path

import pytest

from rendezvous.interop.given_file import given_bytes


def test_a_file_is_read_up_to_the_bytes_allowed(tmp_path: Path):
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert given_bytes(path, most_bytes=5) == b"12345"
    with pytest.raises(OSError, match="Has 5 bytes, more than 4"):
        given_bytes(path, most_bytes=4)


def test_what_may_never_end_or_begin_is_not_opened(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    for path in (Path("/dev/zero"), tmp_path / "pipe"):
        with pytest.raises(OSError, match="Is no regular file"):
            given_bytes(path)


@pytest.mark.parametrize(
    ("name", "said"),
    [("", "Is a directory"), ("nowhere", "No such file"), ("a\0b", "no file's name holds a zero byte")],
)
def test_what_is_no_file_is_told(tmp_path: Path, name: str, said: str):
    with pytest.raises(OSError, match=said):
        given_bytes(tmp_path / name)
