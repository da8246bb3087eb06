"""All uses of numba's undocumented interface, which a release of numba may change."""

import functools
import gc
import io
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from edmsim.compiled import cache


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Disable the garbage collector while numba compiles: it takes a tenth of the time and finds little."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            if gc.get_freeze_count() == 0:  # otherwise unfreezing would undo a freeze of the user's program
                gc.freeze()  # these two move all objects to the oldest generation, which is rarely searched
                gc.unfreeze()
            gc.enable()


_NOTHING = object()


@contextmanager
def replaced(owner: Any, **values: Any) -> Iterator[None]:
    """Replace attributes of an object, class or module temporarily; `unittest.mock` would import asyncio."""
    before = {name: vars(owner).get(name, _NOTHING) for name in values}
    for name, value in values.items():
        setattr(owner, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is _NOTHING:
                delattr(owner, name)
            else:
                setattr(owner, name, value)


with without_garbage_collection():  # the import makes 100,000 objects that are never freed
    import numba
    from numba import core, types
    from numba.extending import intrinsic
    from numba.np import arrayobj, linalg

    with replaced(linalg, ensure_blas=lambda: None):  # loading BLAS takes a tenth of the start-up time
        import_module("numba.np.arraymath")

cgutils, datamodel, populate_array = core.cgutils, core.datamodel, arrayobj.populate_array
AttributeTemplate = core.typing.templates.AttributeTemplate

INLINED: dict[str, Any] = {"forceinline": True, "_nrt": False}
"""Options of a function that is inlined. It does not count references to arrays, because their owner outlives the
call, and atomic counting took a third of the pulse loop's time. So the function must not allocate."""
UNWRAPPED: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of a function that only compiled code calls: every wrapper would compile another copy of the function."""


class _SignedFiles(core.caching.IndexDataCacheFile):  # type: ignore[misc]
    """Files of a function's machine code; each ends with its digest, and damaged files are ignored."""

    def save(self, key: Any, data: Any) -> None:
        with suppress(OSError):  # what cannot be cached, for example on a full disk, is compiled again
            super().save(key, data)

    def _data_name(self, _: int) -> Any:
        # with consecutive numbers, two processes that compile at once would use one name for different code
        return super()._data_name(secrets.randbits(48))

    def _load_index(self) -> Any:
        whole = cache.read_signed(Path(self._index_path)) is not None
        return super()._load_index() if whole else {}

    def _load_data(self, name: str) -> Any:
        path = self._data_path(name)
        if cache.read_signed(Path(path)) is None:
            raise FileNotFoundError(path)
        return super()._load_data(name)

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(cache.signed(content.getvalue()))


@contextmanager
def _in_folder() -> Iterator[None]:
    """Let numba write its cache to the folder of these sources."""
    with replaced(numba.config, CACHE_DIR=str(cache.folder)), replaced(core.caching, IndexDataCacheFile=_SignedFiles):
        yield


def in_cache(make: Callable[[Any], Any], function: Callable[..., Any]) -> Any:
    """Apply one of numba's decorators to a function; the machine code is cached in the folder of these sources."""
    with _in_folder():
        return make(function)


def _link_with_parts(self: Any, library: Any) -> None:
    """Link a library and its parts, each part after all libraries that call it."""
    # LLVM drops functions that nothing has called so far, and a part may be linked already for another caller
    library._ensure_finalized()
    added = [library, *(library._linking_libraries if isinstance(library, _PartLibrary) else ())]
    self._linking_libraries = [*(linked for linked in self._linking_libraries if linked not in added), *added]


class _PartLibrary(core.codegen.JITCodeLibrary):  # type: ignore[misc]
    """A function that is only translated to LLVM IR."""

    # by default numba optimises a function together with everything it calls and makes machine code of it, again for
    # every caller
    add_linking_library = _link_with_parts

    def finalize(self) -> None:
        self._raise_if_finalized()
        self._finalized = True

    def _optimize_functions(self, _module: Any) -> None:
        pass

    def get_pointer_to_function(self, _name: str) -> int:
        return 0

    @property
    def codegen(self) -> Any:
        """Where numba registers the function's environment; a function without machine code has no environment."""
        return self

    def set_env(self, *_: Any) -> None:
        pass


class _WholeLibrary(core.codegen.JITCodeLibrary):  # type: ignore[misc]
    """A function with its parts as machine code; they are optimised together, and not before that one by one."""

    # functions that run a few times per window gain nothing from LLVM's other passes, which double the compile time
    add_linking_library = _link_with_parts

    def _optimize_functions(self, _module: Any) -> None:
        pass

    def _optimize_final_module(self) -> None:
        passes = llvm.create_new_module_pass_manager()
        passes.add_always_inliner_pass()
        passes.add_sroa_pass()
        passes.add_instruction_combine_pass()
        passes.add_simplify_cfg_pass()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(self._final_module, self._codegen._pass_builder(opt=1))


class _PartCompiler(core.compiler.Compiler):  # type: ignore[misc]
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _PartLibrary(self.state.targetctx.codegen(), "part")
        self.state.flags.no_cpython_wrapper = True


class _WholeCompiler(core.compiler.Compiler):  # type: ignore[misc]
    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.state.library = _WholeLibrary(self.state.targetctx.codegen(), "whole")
        self.state.library.enable_object_caching()


def _by_type(self: Any, arguments: Any, named: Any) -> Any:
    """Resolve a call by types alone: numba would translate a function again for every constant argument."""
    plain = tuple(types.unliteral(argument) for argument in arguments)
    return _resolve(self, plain, {name: types.unliteral(kind) for name, kind in named.items()})


_resolve = core.dispatcher._DispatcherBase.get_call_template

_resolved: dict[tuple[Any, ...], Any] = {}
_resolve_function = types.Function.get_call_type


def _resolve_once(self: Any, context: Any, arguments: Any, named: Any) -> Any:
    """Resolve a call of one of numba's own functions, once for each combination of argument types."""
    # by default numba tries some 60 signatures for every addition of two numbers, and again for other constants
    if named or not all(isinstance(argument, types.Number | types.Boolean | types.Array) for argument in arguments):
        return _resolve_function(self, context, arguments, named)
    call = self, context, tuple([types.unliteral(argument) for argument in arguments])
    found = _resolved.get(call)
    if found is None:
        found = _resolve_function(self, context, arguments, named)
        if not any(isinstance(argument, types.Literal) for argument in found.args):
            _resolved[call] = found
    return found


@functools.cache
def _usual(kind: type[core.targetconfig.TargetConfig]) -> dict[str, Any]:
    return {name: kind.options[name].default for name in sorted(kind.options)}


def _values(self: Any) -> dict[str, Any]:
    """Return the values of a function's options, which numba compares whenever it resolves a call."""
    return {**_usual(self.__class__), **self._values}


_process_fully = core.postproc.PostProcessor.run


def _process(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Clean up between numba's passes; compute lifetimes only for the few passes that need them."""
    translated = self.func_ir
    if emit_dels or translated.is_generator:
        _process_fully(self, emit_dels, extend_lifetimes)
        return
    translated.blocks = core.transforms.canonicalize_cfg(translated.blocks)
    translated.variable_lifetime = core.postproc.VariableLifetime(translated.blocks)
    translated.generator_info = None


@contextmanager
def _quickly() -> Iterator[None]:
    """Speed up numba: cache what it computes repeatedly, and omit unused annotations."""
    with (
        replaced(types.Function, get_call_type=_resolve_once),
        replaced(core.targetconfig.TargetConfig, values=_values),
        replaced(core.postproc.PostProcessor, run=_process),
        replaced(core.annotations.type_annotations.TypeAnnotation, __str__=lambda _: ""),
    ):
        yield


class CompiledFunction(core.registry.CPUDispatcher):  # type: ignore[misc]
    """A function that has its own machine code only if Python calls it, not if compiled code does."""

    # Nine of ten functions are only parts of others. A function with fastmath always has its own machine code: inside
    # another function it could round differently, so its bits would depend on what was compiled before.
    depth = 0
    """Number of these functions that are being compiled, each called by the one before."""
    translated: set[tuple[Any, ...]]
    """Types for which the function is translated without machine code."""
    cached = False
    get_call_template = _by_type

    def compile(self, signature: Any) -> Any:
        """Compile for some types, or load it from the cache."""
        kinds = tuple(core.sigutils.normalize_signature(signature)[0])
        with core.compiler_lock.global_compiler_lock, without_garbage_collection(), _quickly():
            if not self.cached:  # not earlier, because most functions are only parts of others
                with _in_folder():
                    self.enable_caching()
                self.cached = True
            if self.targetoptions["fastmath"]:
                with replaced(CompiledFunction, depth=0):
                    return super().compile(signature)
            if CompiledFunction.depth == 0 and kinds in self.translated:
                self.translated.remove(kinds)
                del self.overloads[kinds]
            with replaced(CompiledFunction, depth=CompiledFunction.depth + 1):
                return self._compile(signature, kinds)

    def _compile(self, signature: Any, kinds: tuple[Any, ...]) -> Any:
        known = CompiledFunction.depth == 1 or kinds in self.overloads  # the others are searched in the cache
        if known or self._cache.load_overload(signature, self.targetctx) is not None:
            self._compiler.pipeline_class = _WholeCompiler
            return super().compile(signature)
        self._compiler.pipeline_class = _PartCompiler
        self.translated.add(kinds)
        with replaced(self, _cache=core.caching.NullCache(), _insert=lambda *_: None):  # Python must not find it
            return super().compile(signature)


def with_parts(function: Any) -> Any:
    """Make a numba dispatcher a `CompiledFunction`."""
    function.__class__ = CompiledFunction
    function.translated = set()
    return function


def address_of(function: Any, *kinds: Any) -> int:
    """Return the address of a compiled function's machine code for some types; compile it if necessary."""
    function.compile(kinds)
    made = function.overloads[kinds]
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


def call_returning(kind: Any) -> Any:
    """Return an intrinsic that calls the function at an `address_of` with a tuple of arguments."""
    # The caller is then compiled without the called function, which may be large. The arguments must have the types
    # of the address.
    @intrinsic
    def call(_typingctx: Any, _function: Any, arguments: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            of = signature.args[1].types
            target = builder.inttoptr(values[0], context.call_conv.get_function_type(kind, of).as_pointer())
            passed = cgutils.unpack_tuple(builder, values[1])
            status, result = context.call_conv.call_function(builder, target, kind, of, passed)
            with cgutils.if_unlikely(builder, status.is_error):
                context.call_conv.return_status_propagate(builder, status)
            return result

        return kind(types.int64, arguments), generate

    return call


@contextmanager
def _without_machine_code(compiled: Callable[[str], None]) -> Iterator[None]:
    """Let numba only translate functions to LLVM IR, and report the name of each."""
    # by default numba links a function with everything it calls, optimises that and makes machine code of it, again
    # for every caller
    translate = core.dispatcher._FunctionCompiler.compile

    def translate_and_report(self: Any, *arguments: Any) -> Any:
        done = translate(self, *arguments)
        compiled(f"{self.py_func.__module__}.{self.py_func.__qualname__}")
        return done

    with (
        replaced(core.codegen.CPUCodeLibrary, finalize=_PartLibrary.finalize, _optimize_functions=lambda *_: None),
        replaced(core.codegen.JITCodeLibrary, get_pointer_to_function=lambda *_: 0),
        replaced(core.codegen.JITCPUCodegen, set_env=lambda *_: None),
        replaced(core.dispatcher._FunctionCompiler, compile=translate_and_report),
        replaced(core.dispatcher._DispatcherBase, get_call_template=_by_type),
        _quickly(),
    ):
        yield


def _unchecked_index(context: Any, builder: Any, kind: Any, index: Any, _size: Any) -> Any:
    """Use an index unchanged: the loop has no negative ones, and numba's test for them takes 5 % of its time."""
    return context.cast(builder, index, kind, types.intp)


def whole_program(
    function: Any, signature: tuple[Any, ...], compiled: Callable[[str], None]
) -> tuple[llvm.ModuleRef, str]:
    """Translate a function and all it calls into one LLVM module; return it and the function's name there."""
    with _without_machine_code(compiled), replaced(arrayobj, fix_integer_index=_unchecked_index):
        function.compile(signature)
    result = function.overloads[signature]
    module = llvm.parse_assembly(str(result.library._codegen._create_empty_module("edmsim")))
    waiting, linked = [result.library], []
    while waiting:
        library = waiting.pop()
        if library not in linked:
            linked.append(library)
            module.link_in(library._final_module, preserve=True)
            waiting += library._linking_libraries
    return module, result.fndesc.llvm_func_name
