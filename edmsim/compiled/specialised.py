"""One function compiled once, then made into machine code for the constants of each use.

The pulse loop is fastest where the lengths of its arrays are constants, so that short loops are unrolled. To compile
it again for each resolution would cost half a minute, most of it in numba. Here numba translates it once, with
lengths as arguments, into one module of LLVM's language, which is kept; LLVM puts in constants and makes machine
code, which takes a few seconds and is kept, too.

Both are done by a process of its own that does nothing else: the liberties of `jit` let the compiler order sums, and
the order would depend on what the process had compiled before.
"""

import ctypes
import functools
import gc
import hashlib
import importlib
import inspect
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO, Any

import llvmlite.binding as llvm
from filelock import FileLock

from edmsim.compiled import PROGRESS, cache

Parts = tuple[tuple[str, ...], ...]  # functions of each part of a program with marks; none of one without
_NOTICE = "edmsim compiles its pulse loop for this processor, once"
_BAR = 30
_PROGRAM = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = {path!r}
from edmsim.compiled.specialised import make
make({folder!r}, {module!r}, {name!r}, {constants!r}, {parts!r})
"""
"""Ctrl-C reaches both processes; the one that waits stops this one."""
_NUMBA_SHARE = 0.7  # of the time, for the progress bar


def specialised(function: Callable[..., None], *constants: int) -> Callable[..., None]:
    """Return ``function(*arguments, *constants)``, of whole numbers, in machine code of its first arguments."""
    return _run_by(_loaded(_code(function, constants, ())), len(_parameters(function)) - len(constants))


def marked(
    function: Callable[..., None], *constants: int, parts: Parts
) -> tuple[Callable[..., None], Callable[[], int]]:
    """Return what `specialised` does, compiled with marks, and a function that says which of the parts it is in."""
    engine = _loaded(_code(function, constants, parts))
    run = _run_by(engine, len(_parameters(function)) - len(constants))
    number = ctypes.c_int64.from_address(engine.get_global_value_address(PART))

    def part(*, _engine: Any = engine) -> int:  # the engine owns the number
        return number.value

    return run, part


def _code(function: Callable[..., None], constants: tuple[int, ...], parts: Parts) -> bytes:
    """Return the object file, which is made if it is not there."""
    cached = cache.read_signed(_object_file(_stem(function.__name__, parts), constants))
    return cached or _compile_elsewhere(function, constants, parts)


def _parameters(function: Callable[..., None]) -> list[str]:
    return list(inspect.signature(function).parameters)


@functools.cache
def _processor() -> str:
    """Return what machine code depends on."""
    processor = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    return hashlib.sha256(processor.encode()).hexdigest()[:8]


def _stem(name: str, parts: Parts) -> str:
    """Return what files of a function are called: those with marks otherwise than those without."""
    return f"{name}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:8]}" if parts else name


def _object_file(name: str, constants: tuple[int, ...]) -> Path:
    return cache.folder / f"{name}-{'-'.join(str(int(constant)) for constant in constants)}-{_processor()}.o"


def _loaded(code: bytes) -> llvm.ExecutionEngine:
    """Return an engine that has what is in an object file."""
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _run_by(engine: llvm.ExecutionEngine, count: int) -> Callable[..., None]:
    """Return the engine's program as a function of `count` whole numbers; it lets other threads run."""
    call = ctypes.CFUNCTYPE(ctypes.c_int32, *[ctypes.c_int64] * count)(engine.get_function_address("specialised"))

    def run(*arguments: int, _engine: Any = engine) -> None:  # the engine owns the code
        if call(*arguments):
            raise IndexError("compiled code left an array")

    return run


def _target_machine() -> llvm.TargetMachine:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3,
        codemodel="jitdefault", jit=True,
    )  # fmt: skip


def _pass_builder(machine: llvm.TargetMachine) -> llvm.PassBuilder:
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = True
    return llvm.create_pass_builder(machine, options)


# in the process that waits


def _compile_elsewhere(function: Callable[..., None], constants: tuple[int, ...], parts: Parts) -> bytes:
    """Let another process compile, and return the object file."""
    program = _PROGRAM.format(
        path=sys.path, folder=str(cache.folder), module=function.__module__, name=function.__name__,
        constants=tuple(map(int, constants)), parts=parts,
    )
    # strings' hashes decide the order of the compiler's own sets
    environment = {**os.environ, "PYTHONHASHSEED": "0"}
    try:
        process = subprocess.Popen(
            [sys.executable, "-c", program], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
    except OSError as error:
        raise RuntimeError(f"no process can be started to compile the pulse loop: {error}") from error
    with process:
        try:
            said = _show_progress(process.stderr)  # type: ignore[arg-type]
            code = process.stdout.read()  # type: ignore[union-attr]
        except BaseException:
            process.kill()
            raise
    if process.returncode or not code:
        raise RuntimeError(f"the pulse loop could not be compiled: {said}")
    return code


def _show_progress(lines: IO[bytes]) -> str:
    """Show the progress of another process, which writes shares up to 1; return its last other line."""
    bar = sys.stderr.isatty() or ("ipykernel" in sys.modules and os.environ.get(PROGRESS) != "0")
    said = ""
    for line in lines:
        try:
            share = float(line)
        except ValueError:
            said = line.decode(errors="replace").strip() or said
            continue
        if bar:
            done = round(share * _BAR)
            print(f"\r{_NOTICE} [{'#' * done}{' ' * (_BAR - done)}]", end="", file=sys.stderr, flush=True)
        if share == 1.0:  # what it writes next is the code, for which the pipe has no room until it is read
            break
    if bar:
        print(file=sys.stderr)
    return said


# in the process that compiles


def make(folder: str, module: str, name: str, constants: tuple[int, ...], parts: Parts) -> None:
    """Compile a function of a module, keep it in a folder, and write the object file to the standard output.

    Progress goes to the standard error, a share of the whole in each line.
    """
    cache.folder = Path(folder)
    gc.disable()  # a tenth of the time, for what a process that soon ends need not give back
    stem = _stem(name, parts)
    bitcode = _made_once(cache.folder / f"{stem}-{_processor()}.bc", lambda: _translated(module, name, parts))
    _say(_NUMBA_SHARE)
    code = _made_once(_object_file(stem, constants), lambda: _machine_code(bitcode, constants))
    _say(1.0)
    sys.stdout.buffer.write(code)


def _say(share: float) -> None:
    print(f"{share:.3f}", file=sys.stderr, flush=True)


def _made_once(file: Path, make: Callable[[], bytes]) -> bytes:
    """Return a file's content, which one process makes while others wait for it."""
    with ExitStack() as locks:
        with suppress(OSError):  # where nothing can be written, each process makes its own
            locks.enter_context(FileLock(file.with_suffix(f"{file.suffix}.lock")))
        content = cache.read_signed(file)
        if content is None:
            content = make()
            with suppress(OSError):
                cache.write_signed(file, content)
        return content


def _translated(module: str, name: str, parts: Parts) -> bytes:
    """Return a function and all it calls as LLVM's bitcode, everything inlined into one function named `program`."""
    # here, since putting in constants needs no numba
    from numba import types

    from edmsim.compiled import jit
    from edmsim.compiled.numba_internals import whole_program

    with jit.whole_program_only() as decorated:
        function = getattr(importlib.import_module(module), name)
        total = decorated()
        program = jit.compiled(function)
    done = set()

    def count(translated: str) -> None:
        done.add(translated)
        _say(_NUMBA_SHARE * min(1.0, len(done) / total))

    made, name_there = whole_program(program, (types.int64,) * len(_parameters(function)), count)
    if parts:
        made = llvm.parse_assembly(with_marks(str(made), parts))
    made.get_function(name_there).name = "program"
    for value in (*made.functions, *made.global_variables):
        if not value.is_declaration and value.name not in ("program", PART):
            value.linkage = llvm.Linkage.internal
    called = tuple(map(symbol, jit.apart))
    for value in made.functions:
        if value.name.startswith(called):  # LLVM would inline what is called at one place only
            value.add_function_attribute("noinline")
    passes = llvm.create_new_module_pass_manager()
    # simplified before it is inlined, each function is so once and not at every place where it is called
    for add in (
        passes.add_sroa_pass, passes.add_instruction_combine_pass, passes.add_simplify_cfg_pass,
        passes.add_always_inliner_pass, passes.add_global_dead_code_eliminate_pass,
        passes.add_sroa_pass, passes.add_simplify_cfg_pass,
    ):  # fmt: skip
        add()
    passes.run(made, _pass_builder(_target_machine()))
    return bytes(made.as_bitcode())


def _machine_code(bitcode: bytes, constants: tuple[int, ...]) -> bytes:
    """Return an object file with a function `specialised`: the program with its last arguments as constants."""
    made = llvm.parse_bitcode(bitcode)
    program = made.get_function("program")
    places, numbers = 2, len(list(program.arguments)) - 2  # where numba returns a value and an exception
    free = [f"i64 %a{k}" for k in range(numbers - len(constants))]
    passed = ", ".join([*["ptr %place"] * places, *free, *(f"i64 {constant}" for constant in constants)])
    made.link_in(llvm.parse_assembly(f"""
        target triple = "{made.triple}"
        target datalayout = "{made.data_layout}"
        declare i32 @program({", ".join(["ptr"] * places + ["i64"] * numbers)})
        define i32 @specialised({", ".join(free)}) {{
            %place = alloca [2 x ptr]
            %status = call i32 @program({passed})
            ret i32 %status
        }}
    """))
    program = made.get_function("program")
    program.linkage = llvm.Linkage.internal
    program.add_function_attribute("alwaysinline")
    machine = _target_machine()
    builder = _pass_builder(machine)
    builder.getModulePassManager().run(made, builder)
    _say(0.9)
    return bytes(machine.emit_object(made))


PART = "edmsim_part"  # name of the number (int64): 0 outside, else that of the part, counted from 1


def with_marks(program: str, parts: Sequence[Sequence[str]]) -> str:
    """Let functions of each part of a program (a module of numba's LLVM) say, before they are inlined, that they run.

    A function that is called by one of another part counts for its own; when it ends, the other goes on.
    """
    numbers = {symbol(name): number for number, names in enumerate(parts, 1) for name in names}
    lines: list[str] = []
    found, number = set(), 0
    for line in program.splitlines():
        if line.startswith("define "):
            begins = next((s for s in numbers if f"@{s}" in line.partition("(")[0]), "")
            number = numbers.get(begins, 0)
            found.add(begins)
        if number and line.startswith("  ret "):
            lines.append(f"  store volatile i64 %part.around, ptr @{PART}")
        lines.append(line)
        if number and line == "entry:":
            lines.append(f"  %part.around = load volatile i64, ptr @{PART}")
            lines.append(f"  store volatile i64 {number}, ptr @{PART}")
    if missing := numbers.keys() - found:
        raise LookupError(f"the compiled program has none of the functions {', '.join(sorted(missing))}")
    return "\n".join([*lines, f"@{PART} = global i64 0", ""])


def symbol(name: str) -> str:
    """Return what the symbols of all versions of a function begin with."""
    return "_ZN" + "".join(f"{len(word)}{word}" for word in name.split(".")) + "B"
