"""The decorator of all compiled kernels: numba's, whose cache may be missing, full or damaged.

Compiled code is cached where numba caches it: in ``NUMBA_CACHE_DIR``, next to the source, or in
the user's cache folder. If none of them is writable, kernels are compiled in memory. The cache
contains a digest of the code, so that damaged machine code is never run.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, ParamSpec, TypeVar, cast

import numba
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    NullCache,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)
from numba.core.serialize import dumps

Arguments = ParamSpec("Arguments")
Value = TypeVar("Value")


def njit(kernel: Callable[Arguments, Value]) -> Callable[Arguments, Value]:
    """Compile `kernel`, and cache the code if there is a writable folder."""
    compiled: Any = numba.njit(kernel)
    compiled._cache = _cache_of(kernel)  # noqa: SLF001 (as its `enable_caching` does)
    return cast("Callable[Arguments, Value]", compiled)


def _cache_of(kernel: Callable[..., object]) -> Any:
    try:
        return _Cache(kernel)
    except (OSError, RuntimeError):  # RuntimeError: no folder can be written
        return NullCache()


class _UsersFolder(UserWideCacheLocator):
    """The user's cache folder, if the user has a home; numba would create a folder called ``~``."""

    @classmethod
    def from_function(cls, kernel: Any, file: str) -> Any:
        known = Path.home().is_absolute()  # RuntimeError where there is none
        return super().from_function(kernel, file) if known else None


class _Sealed(CompileResultCacheImpl):
    """The cached form of a kernel: its digest, and numba's form."""

    # An instance variable in name only:
    _locator_classes: ClassVar = [  # type: ignore[misc]
        UserProvidedCacheLocator,
        InTreeCacheLocator,
        _UsersFolder,
    ]

    def reduce(self, compiled: Any) -> tuple[bytes, bytes]:
        content = dumps(super().reduce(compiled))
        return hashlib.sha256(content).digest(), content

    def rebuild(self, target_context: Any, kept: tuple[bytes, bytes]) -> Any:
        digest, content = kept
        if hashlib.sha256(content).digest() != digest:
            raise ValueError("a compiled kernel is damaged")
        return super().rebuild(target_context, pickle.loads(content))  # noqa: S301 (our own)


class _Cache(FunctionCache):
    """Numba's cache, but damaged files count as missing, and failed writes are no errors."""

    _impl_class = _Sealed

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(signature, target_context)
        except Exception:  # noqa: BLE001 (whatever damaged pickles raise)
            with suppress(Exception):
                self.flush()  # for `save_overload`, which reads it, too
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        # What numba raises for a full disk, and for an index that cannot be read or replaced.
        with suppress(Exception):
            super().save_overload(signature, compiled)
