"""Laws as parts of compiled functions: optimised once, linked into what takes them in, no machine code of their own.

numba makes every function ready to be run, also one that is only ever inlined; with a hundred laws to a step that
would be a tenth and more of what an environment's first reset takes.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.untyped_passes import ReconstructSSA


class Part(CPUDispatcher):  # type: ignore[misc]
    """A law that other compiled functions take in. No way in from Python: those took half of the compile time."""

    content: str

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Not from Python: TypeError."""
        raise TypeError(f"{self.py_func.__name__} is a part of compiled functions: call it from one, or without numba")


class _NoEngine:
    """In place of numba's engine, which holds machine code."""

    def set_env(self, *_: Any) -> None:
        """Nothing: :func:`bind_environments` does it for the function that is run."""


class _Library(JITCodeLibrary):  # type: ignore[misc]
    """A law's code as LLVM's own."""

    codegen = property(lambda _: _NoEngine())

    def get_pointer_to_function(self, _name: str) -> int:
        return 0  # as numba says where there is no such function

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


@register_pass(mutates_CFG=False, analysis_only=True)
class _IntoLibrary(AnalysisPass):  # type: ignore[misc]
    """Where the lowering puts the code, before it takes a library of its own."""

    _name = "into_library_of_a_part"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        return False


class PartCompiler(CompilerBase):  # type: ignore[misc]
    """numba's pipeline for a :class:`Part`."""

    def define_pipelines(self) -> Any:
        """numba asks for it."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_IntoLibrary, ReconstructSSA)
        passes.finalize()
        return [passes]


def bind_environments(result: Any) -> None:
    """Give a function that was compiled what its parts would have been given: their constants that are objects."""
    for environment in result._find_referenced_environments():
        result.library.codegen.set_env(environment.env_name, environment)
