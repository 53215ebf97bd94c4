"""Files that a user names, which may be anything: a folder, a device, a pipe."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_BYTES = 1 << 30  # larger than any map or image: 10,000 x 10,000 numbers in plain text take less


def given_bytes(path: Path, *, most_bytes: int = MOST_BYTES) -> bytes:
    """Read a regular file; devices and pipes, which may block or never end, are not opened.

    Raises:
        OSError: it is missing, unreadable, not a regular file or too large; `strerror` says which.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "no file's name holds a zero byte")
    try:
        found = os.stat(path)
    except UnicodeEncodeError as error:
        raise OSError(errno.EINVAL, "no file's name holds half a character") from error
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, "Is a directory")
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "Is no regular file")
    if found.st_size > most_bytes:
        raise OSError(errno.EFBIG, f"Has {found.st_size:,} bytes, more than {most_bytes:,}")
    return path.read_bytes()
