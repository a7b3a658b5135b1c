"""What a worker of a cluster runs: pieces one at a time, by the code that it loaded, whose fingerprint it tells.

A worker may have been started long ago, and its code changed on disk since. So the fingerprint is taken once, when this
module is imported, which happens before any other module of clothkit runs there. Where pieces are given out, it is
imported together with the simulator, not once the first piece is there: sources may be edited in between.
"""

import hashlib
import importlib.metadata
import pickle
import threading
from pathlib import Path
from typing import Any

import cv2

_PACKAGE = Path(__file__).parents[1]
_PACKAGES = ("numpy", "opencv-python-headless", "scipy", "warp-lang")
"""Packages that compute the numbers of a simulation."""


def fingerprint(package: Path = _PACKAGE) -> str:
    """A digest of the sources of a copy of clothkit, and of the versions of the packages that simulate with it."""
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(f"{file.relative_to(package).as_posix()}\0".encode())
        digest.update(file.read_bytes())
    for name in _PACKAGES:
        digest.update(f"{name} {importlib.metadata.version(name)}\0".encode())
    return digest.hexdigest()[:12]


LOADED = fingerprint()
"""The fingerprint of the code that this process has loaded."""

_ONE_AT_A_TIME = threading.Lock()


def run(payload: bytes) -> Any:
    """The result of a pickled function and its arguments. Only one runs at a time, whatever threads a worker has."""
    with _ONE_AT_A_TIME:
        cv2.setNumThreads(1)
        function, arguments, named = pickle.loads(payload)
        return function(*arguments, **named)
