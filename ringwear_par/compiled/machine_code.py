"""Machine code of loops over rows: compiled once by numba, kept, and loaded without it.

To import numba takes ten times as long as to load what it has compiled. The code of a module of
loops is one object file in numba's own cache folder where that has a name, beside the module, or in
a folder of the user's own, whichever may be written to. Processes that find none make it, each for
itself; LLVM's own loader loads it.

A loop is a function of numbers and arrays, whose parameters are annotated as ``Count``, ``Real``,
``Reals``, ``Integers`` or ``Flags``, or as a record: a NamedTuple of such fields and of records.
Arrays are indexed from their first entry on, whatever their axes, and nobody checks their lengths.
The first parameter is the number of rows. What a loop computes are the entries of the arrays that
it sets. Sums are in inner loops that set nothing: others are compiled twice, for arrays that may
overlap and for those that cannot, and sums of the two differ in their last digits.

A ``part`` is a function that loops and other parts call, of their module or of another.
"""

import ctypes
import hashlib
import inspect
import logging
import marshal
import os
import re
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import compress
from operator import is_not
from pathlib import Path
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Annotated, Any, TypeAlias, TypeVar, cast

from ringwear_par.version import numba_version

log = logging.getLogger(__name__)

T = TypeVar("T")

#: parameters of loops: numbers, and contiguous arrays, with the characters of their dtypes
Count: TypeAlias = Annotated[int, ""]
Real: TypeAlias = Annotated[float, ""]
Reals: TypeAlias = Annotated[Any, "d"]
Integers: TypeAlias = Annotated[Any, "l"]
Flags: TypeAlias = Annotated[Any, "?b"]
#: loops compare the places of all their arrays, as these might overlap; LLVM by itself of few
_OPTION = "-runtime-memory-check-threshold=300"
_BESIDE = Path(__file__).parent / "__pycache__"
#: as it is imported: it may be another when loops are loaded
_SOURCE = Path(__file__).read_bytes()
#: what this process has loaded
_LOADERS: list[Any] = []

#: functions that loops call, and those that add in the order in which they are written
_PARTS: set[FunctionType] = set()
_IN_ORDER: set[FunctionType] = set()

_first_byte, _reference = ctypes.c_char.from_buffer, ctypes.byref


def part(function: T) -> T:
    """Let a function be a part of loops."""
    _PARTS.add(cast(FunctionType, function))
    return function


def in_order(function: T) -> T:
    """Let a function add in the order in which it is written, and round multiply-adds once."""
    _IN_ORDER.add(cast(FunctionType, function))
    return function


@cache
def load(module: ModuleType) -> Any:
    """Return the loops of a module, compiled, as attributes of these names. Not collective.

    Digits are the same whether loops have been compiled now or before, though not on all kinds of
    processors. Arguments are as in the source. Arrays have to be contiguous and writable, or
    TypeError, BufferError or ValueError is raised.

    A loop keeps the arrays of its last call alive (14 MB of all loops, after 1,024 histories of 64
    elements, 27 MB where these have moduli of their own), and reads them where they were, of what
    type they were, while they, or the records that have them, are the same objects. So callers
    change their entries only: nothing may put other memory, another dtype or shape into an array
    that a loop has had. NumPy's ``resize`` refuses to, but for ``refcheck=False``; assignments to
    ``data``, ``dtype``, ``shape`` and ``strides`` are not noticed.
    """
    import llvmlite.binding as llvm  # takes long, and results are read without loops

    loops = [
        function
        for function in vars(module).values()
        if isinstance(function, FunctionType)
        and function.__module__ == module.__name__
        and function not in _PARTS
    ]
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    loader = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine(llvm))
    code = _stored_code(llvm, module.__name__.rpartition(".")[2], loops)
    loader.add_object_file(llvm.object_file.ObjectFileRef.from_data(code))
    loader.finalize_object()
    _LOADERS.append(loader)
    return SimpleNamespace(
        **{f.__name__: _call(f, loader.get_function_address(_symbol(f))) for f in loops}
    )


def _call(function: FunctionType, address: int) -> Callable[..., None]:
    """Return the compiled loop at an address as a function with the parameters of its source.

    What is the same object as the last time has been converted already: most arrays outlive many
    calls, and to convert them takes longer than most loops.
    """
    annotations = [p.annotation for p in inspect.signature(function).parameters.values()]
    count, conversions = len(annotations), [_conversion(function, a) for a in annotations]
    places = [*_places(annotations)]
    # numba's own convention: places of what is returned and raised, neither of which there is;
    # loops are so short that to let other threads run takes longer
    native = ctypes.PYFUNCTYPE(ctypes.c_int32)(address)
    place = ctypes.byref(ctypes.c_void_p())
    last: tuple[Sequence[Any], list[Any]] = (
        [None] * count,
        [None] * sum(len(_kinds(annotation)) for annotation in annotations),
    )

    def call(*arguments: Any) -> None:
        nonlocal last
        if not arguments[0]:
            return  # arrays without entries have no place
        if len(arguments) != count:
            raise TypeError(f"{function.__name__}: {len(arguments)} arguments, not {count}")
        before, converted = last
        changed = [*compress(range(count), map(is_not, arguments, before))]
        if changed:
            converted = converted.copy()  # a thread that calls meanwhile has the other
            for i in changed:
                converted[places[i]] = conversions[i](arguments[i])
            last = arguments, converted
        native(place, None, *converted)

    return call


def _places(annotations: Sequence[Any]) -> Iterator[int | slice]:
    """Yield where parameters are in machine code, which has the fields of records one by one."""
    start = 0
    for annotation in annotations:
        stop = start + len(_kinds(annotation))
        yield slice(start, stop) if _is_record(annotation) else start
        start = stop


def _conversion(function: FunctionType, annotation: Any) -> Callable[[Any], Any]:
    """Return the conversion of an argument to one of machine code, of a record to several."""
    kinds = _kinds(annotation)
    conversions = [_conversion_of_kind(function, *kind) for kind in kinds]
    if not _is_record(annotation):
        return conversions[0]
    return lambda record: [
        convert(value) for convert, value in zip(conversions, _values(record), strict=True)
    ]


def _conversion_of_kind(function: FunctionType, kind: Any, dtypes: str) -> Callable[[Any], Any]:
    if not dtypes:
        return ctypes.c_int64 if kind is int else ctypes.c_double

    def place_of(array: Any) -> Any:
        if array.dtype.char not in dtypes:
            raise TypeError(f"{function.__name__}: no argument may be an array of {array.dtype}")
        return _reference(_first_byte(array)) if array.size else None

    return place_of


def _values(record: Any) -> Iterator[Any]:
    """Yield the numbers and arrays of a record, and of those in it."""
    for value in record:
        if isinstance(value, tuple):
            yield from _values(value)
        else:
            yield value


def _is_record(annotation: Any) -> bool:
    return hasattr(annotation, "_fields")


def _kinds(annotation: Any) -> list[tuple[Any, str]]:
    """Return the kinds of a parameter in machine code, which has the fields of records.

    They are int, float or, of an array, Any, with the dtypes that it may have.
    """
    if _is_record(annotation):
        return [kind for field in annotation.__annotations__.values() for kind in _kinds(field)]
    return [(annotation.__origin__, annotation.__metadata__[0])]


def _symbol(function: FunctionType) -> str:
    return f"ringwear_{function.__name__}"


def _target_machine(llvm: Any) -> Any:
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        jit=True,
    )


# -- the object file -------------------------------------------------------------------------------


def _stored_code(llvm: Any, module: str, loops: Sequence[FunctionType]) -> bytes:
    """Return the object file of a module's loops, which is made where there is none."""
    import llvmlite

    processor = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    contents = [_content(function) for function in _with_parts(loops)]
    stem = f"{module}-{_digest(processor)}"
    name = f"{stem}-{_digest((_SOURCE, contents, numba_version(), llvmlite.__version__))}.o"
    places = [folder / name for folder in _folders()]
    for place in places:
        with suppress(OSError):
            code = place.read_bytes()
            is_whole = hashlib.sha256(code[32:]).digest() == code[:32]
            if is_whole and _is_trusted(place) and _is_trusted(place.parent):
                return code[32:]
    code = _compile(llvm, loops)
    for place in places:
        try:
            place.parent.mkdir(0o700, exist_ok=True)
            if _is_trusted(place.parent):
                _write(place, hashlib.sha256(code).digest() + code)
                break
        except OSError as error:
            log.debug("%s: %s", place, error.strerror)
    for older in {*_BESIDE.glob(f"{stem}-*.o")} - {_BESIDE / name}:
        with suppress(OSError):
            older.unlink()
    return code


def _parts_of(function: FunctionType) -> list[FunctionType]:
    """Return the parts that a function calls itself."""
    called = (function.__globals__.get(name) for name in function.__code__.co_names)
    return [part for part in called if isinstance(part, FunctionType) and part in _PARTS]


def _with_parts(functions: Sequence[FunctionType]) -> list[FunctionType]:
    """Return functions and the parts that they call, and those that these do."""
    every = dict.fromkeys(functions)
    for function in functions:
        every |= dict.fromkeys(_with_parts(_parts_of(function)))
    return list(every)


def _content(function: FunctionType) -> tuple[Any, ...]:
    """Return the contents of a function, whose source may have changed since its import."""
    code = function.__code__.replace(co_filename="", co_firstlineno=1, co_linetable=b"")
    numbers = [function.__globals__.get(name) for name in code.co_names]
    constants = [number for number in numbers if isinstance(number, int | float)]
    annotations = {name: _words(a) for name, a in function.__annotations__.items()}
    # of the second format, as later ones depend on references
    return marshal.dumps(code, 2), constants, function in _IN_ORDER, annotations


def _words(annotation: Any) -> Any:
    """Return an annotation in words, a record by its fields."""
    if not _is_record(annotation):
        return annotation
    return {name: _words(field) for name, field in annotation.__annotations__.items()}


def _digest(parts: object) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]


def _folders() -> Iterator[Path]:
    """Yield the folders in which code may be."""
    if named := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(named)
    yield _BESIDE
    yield Path(tempfile.gettempdir()) / f"ringwear-compiled-{os.getuid()}"


def _is_trusted(path: Path) -> bool:
    """Tell whether nobody may write to a path who may not write the source: code is executed."""
    status, source = path.lstat(), _BESIDE.parent.stat()
    is_own = status.st_uid in {os.geteuid(), source.st_uid} and not stat.S_ISLNK(status.st_mode)
    return is_own and not status.st_mode & ~source.st_mode & 0o022


def _write(path: Path, content: bytes) -> None:
    """Write a file at once, as other processes read it."""
    handle, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _compile(llvm: Any, loops: Sequence[FunctionType]) -> bytes:
    """Return the object file of loops."""
    llvm.set_option("", _OPTION)
    import numba  # takes long
    from numba import types

    kinds = {
        (int, ""): types.int64,
        (float, ""): types.float64,
        (Any, "d"): types.CPointer(types.float64),
        (Any, "l"): types.CPointer(types.int64),
        (Any, "?b"): types.CPointer(types.int8),
    }

    def type_of(annotation: Any) -> Any:
        if _is_record(annotation):
            fields = [type_of(field) for field in annotation.__annotations__.values()]
            return types.NamedTuple(fields, annotation)
        return kinds[_kinds(annotation)[0]]

    def options(function: FunctionType) -> dict[str, Any]:
        # sums may be of several entries at a time
        sums = {"contract"} if function in _IN_ORDER else {"reassoc"}
        return {"error_model": "numpy", "fastmath": sums}

    def with_parts(function: FunctionType) -> FunctionType:
        compiled = {part.__name__: compile_part(part) for part in _parts_of(function)}
        names = {**function.__globals__, **compiled}
        return FunctionType(function.__code__, names, function.__name__)

    @cache
    def compile_part(function: FunctionType) -> Any:
        return numba.njit(**options(function))(with_parts(function))

    module: Any = None
    for function in loops:
        parameters = inspect.signature(function).parameters.values()
        signature = types.void(*[type_of(parameter.annotation) for parameter in parameters])
        loop = numba.cfunc(signature, **options(function))(with_parts(function))
        # of the loop and what calls it for C the former; the latter needs all of numba
        code = re.sub(r'(?ms)^define [^\n]*@"?cfunc\..*?^}\n', "", loop.inspect_llvm())
        mangled = loop.native_name.removeprefix("cfunc.")
        loop_module = llvm.parse_assembly(code.replace(mangled, _symbol(function)))
        if module is None:
            module = loop_module
        else:
            module.link_in(loop_module)
    module.verify()
    return bytes(_target_machine(llvm).emit_object(module))
