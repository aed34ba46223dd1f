"""Functions are loaded from numba's cache without preparing its compiler."""

from __future__ import annotations

from contextlib import nullcontext

from kernel_cache.loading import load_without_compiler


class Cache:
    """Stands for numba's cache of a function."""

    def _load_overload(self, signature: str, context: Context) -> str:
        return f"loaded {signature}"

    _guard_against_spurious_io_errors = staticmethod(nullcontext)

    def load_overload(self, signature: str, context: Context) -> str:
        context.refresh()
        return self._load_overload(signature, context)


class Context:
    """Stands for numba's context, whose refresh prepares the compiler."""

    def refresh(self) -> None:
        raise AssertionError


class Dispatcher:
    """Stands for a function of numba."""

    def __init__(self) -> None:
        self._cache = Cache()


def test_a_function_is_loaded_without_preparing_the_compiler(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr("kernel_cache.loading.prepare_runtime", lambda context: None)
    dispatcher = Dispatcher()
    load_without_compiler(dispatcher)
    assert dispatcher._cache.load_overload("float64", Context()) == "loaded float64"


def test_another_version_of_numba_is_left_as_it_is() -> None:
    load_without_compiler(object())
