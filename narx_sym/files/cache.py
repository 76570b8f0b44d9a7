"""Bytes kept between processes, each under the text that it was made from: what can be made again, only slower.

Nothing here raises: a folder that is missing, full, read-only, or somebody else's means that nothing is kept.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

VARIABLE = "NARX_SYM_CACHE"  # a folder instead of the user's cache folder; "off" keeps nothing
OFF = ("", "0", "off", "no")
LARGEST, MANY = 64_000_000, 8_000  # bytes and files; beyond either the older half goes
MODE = 0o600


def kept(text: str) -> bytes | None:
    """Return what was kept under a text; None where nothing is, or where it is damaged."""
    folder = _folder(os.environ.get(VARIABLE))
    if folder is None:
        return None
    with suppress(OSError):
        descriptor = os.open(folder / _name(text), os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
        with open(descriptor, "rb") as file:
            if not _own(os.fstat(descriptor)):
                return None
            whole = file.read(LARGEST)
        digest, content = whole[:32], whole[32:]
        return content if digest == _digest(text, content) else None
    return None


def keep(text: str, content: bytes) -> None:
    """Keep bytes under a text: the file appears whole or not at all."""
    folder = _folder(os.environ.get(VARIABLE))
    if folder is None:
        return
    name = _name(text)
    part = folder / f".{name}.{os.getpid()}.part"
    with suppress(OSError):
        try:
            descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), MODE)
            with open(descriptor, "wb") as file:  # not flushed to the disk: what is damaged is seen by its digest
                file.write(_digest(text, content) + content)
            os.replace(part, folder / name)
        finally:
            part.unlink(missing_ok=True)


def made(text: str, make: Callable[[], bytes]) -> bytes:
    """Return what was kept under a text; else make it, and keep it."""
    content = kept(text)
    if content is None:
        content = make()
        keep(text, content)
    return content


@lru_cache(maxsize=8)
def _folder(given: str | None) -> Path | None:
    """Return the folder, made and tidied once per process; None where nothing is kept."""
    if given is not None and given.strip().lower() in OFF:
        return None
    with suppress(OSError, RuntimeError):  # without a home there is no cache
        folder = (Path(given) if given else _user()) / "narx_sym"
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()  # a link is refused
        if stat.S_ISDIR(found.st_mode) and _own(found):
            _tidied(folder)
            return folder
    return None


def _user() -> Path:
    """Return where the system wants what can be made again."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _own(found: os.stat_result) -> bool:
    """Whether a file or a folder belongs to this user, and nobody else may touch it."""
    if not hasattr(os, "geteuid"):  # Windows: the user's profile is the user's own
        return True
    return found.st_uid == os.geteuid() and not found.st_mode & 0o077


def _name(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _digest(text: str, content: bytes) -> bytes:
    return hashlib.sha256(_name(text).encode() + content).digest()


def _tidied(folder: Path) -> None:
    """Remove the older half where there is too much."""
    with os.scandir(folder) as entries:
        found = sorted(((e.stat(follow_symlinks=False), e.path) for e in entries), key=lambda f: f[0].st_mtime)
    if len(found) <= MANY and sum(state.st_size for state, _ in found) <= LARGEST:
        return
    for _, path in found[: (len(found) + 1) // 2]:
        with suppress(OSError):
            os.unlink(path)
