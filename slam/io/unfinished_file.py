"""Single output files: complete, or not written at all."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import OutputError
from .atomic_swap import sync_file


@contextmanager
def unfinished_file(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """Yield a temporary file beside `path`, renamed to it if the block ends without an error, else removed.

    It is on the disk before it is renamed. Raises OutputError if `path` exists and `overwrite` is not set, or if it
    cannot be written.
    """
    if path.is_dir():
        raise OutputError(f"{path}: is a directory")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no directory {path.parent}")
    if path.exists() and not overwrite:
        raise OutputError(f"{path}: exists already; choose another name or add --overwrite")
    # The name is random: a file that came with a foreign map could be a link with a foreseen name, to any file.
    work = path.with_name(f".{path.stem}-{secrets.token_hex(8)}{path.suffix}")
    try:
        yield work
        sync_file(work)
        work.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        work.unlink(missing_ok=True)
