"""One function compiled once, then made into machine code for the constants of each use.

The pulse loop is fastest if the lengths of its arrays are constants, because short loops are then unrolled. Compiling
it again for each resolution would take half a minute, most of it in numba. So numba translates it only once, with
lengths as arguments, into one LLVM module. LLVM then inserts the constants and makes machine code, which takes a few
seconds. Both results are cached.

A separate process does both and nothing else: `jit` allows the compiler to reorder sums, and the order would depend
on what the process had compiled before.
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

Parts = tuple[tuple[str, ...], ...]  # functions of each marked part of a program; empty for a program without marks
_NOTICE = "edmsim compiles its pulse loop for this processor, once"
_BAR = 30
_PROGRAM = """
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = {path!r}
from edmsim.compiled.specialised import make
make({folder!r}, {module!r}, {name!r}, {constants!r}, {parts!r})
"""
"""Ignore Ctrl-C, which reaches both processes: the waiting one stops this one."""
_NUMBA_SHARE = 0.7  # share of the time, for the progress bar


def specialised(function: Callable[..., None], *constants: int) -> Callable[..., None]:
    """Return ``function(*arguments, *constants)`` of integers as machine code that takes only the first arguments."""
    return _run_by(_loaded(_code(function, constants, ())), len(_parameters(function)) - len(constants))


def marked(
    function: Callable[..., None], *constants: int, parts: Parts
) -> tuple[Callable[..., None], Callable[[], int]]:
    """Return the same as `specialised`, compiled with marks, and a function that returns the part that is running."""
    engine = _loaded(_code(function, constants, parts))
    run = _run_by(engine, len(_parameters(function)) - len(constants))
    number = ctypes.c_int64.from_address(engine.get_global_value_address(PART))

    def part(*, _engine: Any = engine) -> int:  # the engine owns the number
        return number.value

    return run, part


def _code(function: Callable[..., None], constants: tuple[int, ...], parts: Parts) -> bytes:
    """Return the content of the object file, which is made if it does not exist."""
    cached = cache.read_signed(_object_file(_stem(function.__name__, parts), constants))
    return cached or _compile_elsewhere(function, constants, parts)


def _parameters(function: Callable[..., None]) -> list[str]:
    return list(inspect.signature(function).parameters)


@functools.cache
def _processor() -> str:
    """Return the properties of the processor on which machine code depends."""
    processor = f"{llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"
    return hashlib.sha256(processor.encode()).hexdigest()[:8]


def _stem(name: str, parts: Parts) -> str:
    """Return the stem of a function's file names; code with marks has another one."""
    return f"{name}-{hashlib.sha256(repr(parts).encode()).hexdigest()[:8]}" if parts else name


def _object_file(name: str, constants: tuple[int, ...]) -> Path:
    return cache.folder / f"{name}-{'-'.join(str(int(constant)) for constant in constants)}-{_processor()}.o"


def _loaded(code: bytes) -> llvm.ExecutionEngine:
    """Return an engine that has loaded an object file."""
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _run_by(engine: llvm.ExecutionEngine, count: int) -> Callable[..., None]:
    """Return the engine's program as a function of `count` integers, which releases the GIL."""
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


# in the waiting process


def _compile_elsewhere(function: Callable[..., None], constants: tuple[int, ...], parts: Parts) -> bytes:
    """Start a process that compiles, and return the object file."""
    program = _PROGRAM.format(
        path=sys.path, folder=str(cache.folder), module=function.__module__, name=function.__name__,
        constants=tuple(map(int, constants)), parts=parts,
    )
    # the order of the compiler's sets depends on the hashes of strings
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
    """Show the progress that another process writes as shares up to 1; return its last line of other text."""
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
        if share == 1.0:  # now it writes the code, which does not fit into the pipe and must be read by the caller
            break
    if bar:
        print(file=sys.stderr)
    return said


# in the compiling process


def make(folder: str, module: str, name: str, constants: tuple[int, ...], parts: Parts) -> None:
    """Compile a function of a module, cache it in a folder, and write the object file to standard output.

    Progress goes to standard error: one line per step, with the share that is done.
    """
    cache.folder = Path(folder)
    gc.disable()  # collecting takes a tenth of the time, and this process ends soon
    stem = _stem(name, parts)
    bitcode = _made_once(cache.folder / f"{stem}-{_processor()}.bc", lambda: _translated(module, name, parts))
    _say(_NUMBA_SHARE)
    code = _made_once(_object_file(stem, constants), lambda: _machine_code(bitcode, constants))
    _say(1.0)
    sys.stdout.buffer.write(code)


def _say(share: float) -> None:
    print(f"{share:.3f}", file=sys.stderr, flush=True)


def _made_once(file: Path, make: Callable[[], bytes]) -> bytes:
    """Return a file's content; one process makes it while others wait."""
    with ExitStack() as locks:
        with suppress(OSError):  # in a read-only folder every process makes its own
            locks.enter_context(FileLock(file.with_suffix(f"{file.suffix}.lock")))
        content = cache.read_signed(file)
        if content is None:
            content = make()
            with suppress(OSError):
                cache.write_signed(file, content)
        return content


def _translated(module: str, name: str, parts: Parts) -> bytes:
    """Return a function and all it calls as LLVM's bitcode, everything inlined into one function named `program`."""
    # imported here, because inserting the constants needs no numba
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
        if value.name.startswith(called):  # LLVM would inline a function that is called in one place only
            value.add_function_attribute("noinline")
    passes = llvm.create_new_module_pass_manager()
    # a function that is simplified before it is inlined is simplified once, not at every call
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
    places, numbers = 2, len(list(program.arguments)) - 2  # numba returns a value and an exception through pointers
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


PART = "edmsim_part"  # name of an int64 variable: number of the running part, counted from 1; 0 outside all parts


def with_marks(program: str, parts: Sequence[Sequence[str]]) -> str:
    """Let the functions of each part store the part's number while they run; `program` is numba's LLVM assembly.

    A function that another part calls counts for its own part; when it returns, the caller's number is restored.
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
    """Return the common prefix of the symbols of all versions of a function."""
    return "_ZN" + "".join(f"{len(word)}{word}" for word in name.split(".")) + "B"
